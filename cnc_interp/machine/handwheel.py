"""A handwheel: each count moves the selected axes by one step, within their limits."""

from cnc_interp.machine.jog import Jog
from cnc_interp.machine.playback import Playback
from cnc_interp.machine_model.signals import COUNTS, STEP, handwheel_input

USUAL_STEP = 0.01  #: Travel per count if the machine has no input ``STEP`` [mm, deg].


class Handwheel:
    def __init__(self, playback: Playback, jog: Jog):
        self._playback, self._jog, self._before = playback, jog, 0.0
        self._machine = playback.axes.machine
        signals = self._machine.signals
        self._counts, self._step = signals.input(COUNTS), signals.input(STEP)
        self._chosen = [signals.input(handwheel_input(axis.name)) for axis in self._machine.axes]
        self._seen = False

    def work(self, ignored: bool = False) -> None:
        """Move the selected axes by the new counts; raise StreamError if that is impossible."""
        if self._counts < 0:
            return
        inputs = self._playback.drives.inputs
        turned, self._before = inputs[self._counts] - self._before, float(inputs[self._counts])
        seen, self._seen = self._seen, True
        if not (turned and seen) or ignored:
            return
        step = inputs[self._step] if self._step >= 0 else USUAL_STEP
        target, values = self._jog.target, {}
        for i, axis in enumerate(self._machine.axes):
            if self._chosen[i] >= 0 and inputs[self._chosen[i]]:
                wanted = float(target[i] + turned * step * axis.shown_size)
                values[axis.name] = min(max(wanted, axis.travel[0]), axis.travel[1])
        if values:
            self._jog.move(values, relative=False, tool=0.0, speed=0.0)
