"""Public data sets and the user's own captures, in the folder layouts that they come in."""

from gscpe.datasets.dataset import Dataset

__all__ = ["Dataset"]
