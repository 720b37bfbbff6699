"""Diagnosis: what a fit misses, where, which effect, what it cannot be told from, what to measure next."""

from ..evidence.shapes import play_operator
from .findings import largest
from .outliers import gross_errors
from .questions import diagnose
from .result import Diagnosis, Finding
from .template import indistinguishable, sentence, template

__all__ = [
    "Diagnosis",
    "Finding",
    "diagnose",
    "gross_errors",
    "indistinguishable",
    "largest",
    "play_operator",
    "sentence",
    "template",
]  # fmt: skip
