"""Forty paths with their optima, all made by code, to compare feed laws."""

from cnc_interp.problems.paths import Known, Problem, known, problem, problems, stretches
from cnc_interp.problems.score import Score, score

__all__ = ['Known', 'Problem', 'Score', 'known', 'problem', 'problems', 'score', 'stretches']
