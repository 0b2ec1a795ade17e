"""Releases: data sets and trained policies as folders that can be published.

`release` writes both, as `logicity release` does, and `pack_policies` only policies. Each folder has a card, a license
and checksums, and a data set also a datasheet and Croissant metadata.
"""

from .datasets import DataSetOptions
from .policies import ResultsFile, pack_policies
from .write import Release, release

__all__ = ["DataSetOptions", "Release", "ResultsFile", "pack_policies", "release"]
