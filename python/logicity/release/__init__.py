"""Releases: data sets and trained policies as folders that can be published.

`release` writes both. Each folder has a card, a licence and checksums, and a data set also a data sheet and Croissant
metadata.
"""

from .datasets import DataSetOptions, data_sets
from .policies import pack_policies
from .write import Release, release

__all__ = ["DataSetOptions", "Release", "data_sets", "pack_policies", "release"]
