"""shmoo_mjx: interactive navigation by adaptive pushing, in JAX and MuJoCo.

What most programs need can be had from here; ``__init__.pyi`` says where each name lives. A name is imported when it is
first used, so that ``import shmoo_mjx`` costs nothing.
"""

import lazy_loader

__version__ = "1.0.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
