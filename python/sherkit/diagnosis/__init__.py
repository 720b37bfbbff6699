"""Diagnosis: what a fit misses, where, which effect, what it cannot be told from, what to measure next."""

from .answers import Diagnosis
from .questions import diagnose
from .shapes import play_operator
from .template import sentence, template

__all__ = ["Diagnosis", "diagnose", "play_operator", "sentence", "template"]
