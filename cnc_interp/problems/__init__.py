"""Forty generated paths with their optimum times, to compare feed laws."""

from cnc_interp.problems.paths import (
    Known,
    Problem,
    Score,
    known,
    problem,
    problems,
    score,
    stretches,
)

__all__ = ['Known', 'Problem', 'Score', 'known', 'problem', 'problems', 'score', 'stretches']
