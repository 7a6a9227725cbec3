"""Everything that fits the parameters of a drive or its controller to something: identify, tune, sweep, diagnose.

The names are those of `__init__.pyi`; each is imported when it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
