"""The catalogue of effects that a nominal drive leaves out (docs/effects.md), and how one of your own joins it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
