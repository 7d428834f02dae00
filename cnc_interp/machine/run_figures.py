"""Statistics of a run, which the machine node reports in addition to its state."""

import numpy as np

from cnc_interp.machine.axis_motion import AxisMotion, Recording
from cnc_interp.run.setpoints import Setpoints


class RunFigures:
    def __init__(self, axes: AxisMotion):
        self._axes = axes
        self.begin()

    def begin(self) -> None:
        """Reset all figures for a new run."""
        self.approach_samples = self.starvations = 0
        self.begin_motion()

    def begin_motion(self) -> None:
        """Reset the figures of the motion, which begins with the approach or the program."""
        self._axes.largest_use = np.zeros_like(self._axes.largest_use)
        self.largest_following_error = np.zeros(len(self._axes.machine.axis_names))
        self.largest_contour_error = 0.0
        self.least_buffered = np.inf

    def add(self, samples: Setpoints, feedback: Recording) -> None:
        """Update the figures with executed setpoints."""
        self.approach_samples += int(np.sum(samples.block == 0))
        error = np.abs(feedback.following_error).max(axis=0)
        self.largest_following_error = np.maximum(self.largest_following_error, error)
        contour_error = float(feedback.contour_error.max())
        self.largest_contour_error = max(self.largest_contour_error, contour_error)
