"""The effects that a nominal drive leaves out (docs/reference/effects.md), and `register` for further ones."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
