from .identify import Identification, identify

__all__ = ["Identification", "identify"]
