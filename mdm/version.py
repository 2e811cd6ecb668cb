"""The version of the program, which the package's metadata has from here."""

__all__ = ["__version__"]

__version__ = "0.2.0"
