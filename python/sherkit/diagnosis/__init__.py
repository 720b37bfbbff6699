"""Diagnosis: what a fit misses, where, which effect, what it cannot be told from, what to measure next."""

from .answers import Diagnosis, largest
from .questions import diagnose
from .shapes import play_operator
from .template import sentence, template, ties

__all__ = ["Diagnosis", "diagnose", "largest", "play_operator", "sentence", "template", "ties"]
