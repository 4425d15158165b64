"""shmoo_mjx: interactive navigation by adaptive pushing, in JAX and MuJoCo."""

__version__ = "0.1.0"
