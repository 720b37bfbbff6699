"""Diagnosis: what a fit misses, where, which effect, what it cannot be told from, what to measure next."""

from .answers import Diagnosis
from .finding import Finding
from .findings import largest
from .questions import diagnose
from .shapes import play_operator
from .template import indistinguishable, sentence, template

__all__ = ["Diagnosis", "Finding", "diagnose", "indistinguishable", "largest", "play_operator", "sentence", "template"]
