"""The keys of a page: stops, start and reset, switches, overrides; the outputs."""

from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial
from typing import Any

from cnc_interp_msgs.msg import MachineSignals
from nicegui import events, ui

from cnc_interp.client.operator_client import SWITCHES, OperatorClient
from cnc_interp.page.contact import Command, asked, key, pressing
from cnc_interp.page.desk import Desk
from cnc_interp.settings.options import Settings

MOST, STEP = 150, 5  #: Largest feed override, and the step of the keys [%].
SPINDLE = (50, 120)  #: Least and largest spindle override [%].
RAPIDS = (25, 50, 100)  #: Keys of the rapid override [%].

large = partial(key, look='unelevated')


class HeldSlider(ui.slider):
    """A slider that stays where the user moves it, without waiting for the server's answer."""

    LOOPBACK = False


class OverrideSlider:
    """The feed override of a page: a slider, and keys that move it by a step or to 100 %."""

    def __init__(self, nodes: OperatorClient, may_set: Callable[[], bool]):
        self._nodes, self._may_set = nodes, may_set
        self._shown: float | None = None
        self._slider = HeldSlider(min=0, max=MOST, step=STEP, value=100, on_change=self._set)
        self._slider.props('dense data-mark="override slider"')
        with ui.element('div').classes('share'):
            self._text = ui.label('feed 100%').props('data-mark="override"')
            keys = [
                key('−', 'slower', lambda: self._move(self._slider.value - STEP)),
                key('+', 'faster', lambda: self._move(self._slider.value + STEP)),
                key('100%', act=lambda: self._move(100)),
            ]
        self.elements = (self._slider, *keys)

    def _move(self, percent: float) -> None:
        self._slider.set_value(min(max(percent, 0), MOST))
        self._slider.update()

    def _set(self, event: events.ValueChangeEventArguments) -> None:
        """Move the slider only for changes by others; it already shows the user's own value."""
        if self._shown is not None and event.value == round(100 * self._shown):
            return  # moved by this program, to show what others have set
        if self._may_set():
            self._shown = event.value / 100
            self._text.set_text(f'feed {event.value:.0f}%')
            self._nodes.set_override(event.value / 100)
        else:
            self.show_again()

    def show(self) -> None:
        value = self._nodes.override_of('feed_override')
        if self._shown != value:
            self._shown = value
            self._slider.set_value(round(100 * value))
            self._text.set_text(f'feed {value:.0%}')

    def show_again(self) -> None:
        """Show the actual value; input made while the connection was interrupted is lost."""
        self._shown = None
        self._slider.update()


class RapidKeys:
    """The rapid override of a page: a key for each value; the key of the active value is lit."""

    def __init__(self, nodes: OperatorClient, may_set: Callable[[], bool]):
        self._nodes, self._may_set = nodes, may_set
        self._shown: float | None = None
        with ui.element('div').classes('share'):
            self._text = ui.label('rapids').props('data-mark="rapids"')
            self.keys = {
                percent: key(
                    f'{percent}%', f'rapid {percent}%', partial(self._set, percent), 'blue-grey-9'
                )
                for percent in RAPIDS
            }

    def _set(self, percent: int) -> None:
        if self._may_set():
            self._nodes.set_override(percent / 100, 'rapid_override')

    def show(self) -> None:
        value = self._nodes.override_of('rapid_override')
        if self._shown == value:
            return
        self._shown = value
        lit = round(100 * value, 6)
        self._text.set_text('rapids' if lit in self.keys else f'rapids {lit:g}%')
        for percent, one in self.keys.items():
            on = percent == lit
            colour, pressed = ('primary', 'true') if on else ('blue-grey-9', 'false')
            one.props(f'color={colour} aria-pressed={pressed}')


class SpindleKeys:
    """The spindle override of a page: keys that move it by a step or to 100 %."""

    def __init__(self, nodes: OperatorClient, may_set: Callable[[], bool]):
        self._nodes, self._may_set = nodes, may_set
        with ui.element('div').classes('share'):
            self._text = ui.label('spindle 100%').props('data-mark="spindle override"')
            self.keys = [
                key('−', 'spindle slower', partial(self._move, -STEP)),
                key('+', 'spindle faster', partial(self._move, STEP)),
                key('100%', 'spindle 100%', partial(self._set, 100)),
            ]

    def _percent(self) -> int:
        return round(100 * self._nodes.override_of('spindle_override'))

    def _move(self, step: int) -> None:
        self._set(min(max(self._percent() + step, SPINDLE[0]), SPINDLE[1]))

    def _set(self, percent: int) -> None:
        if self._may_set():
            self._nodes.set_override(percent / 100, 'spindle_override')

    def show(self) -> None:
        self._text.set_text(f'spindle {self._percent()}%')


class Switch:
    def __init__(
        self, name: str, is_on: Callable[[], bool], turn: Callable[[bool], Awaitable[None]]
    ):
        name = name.replace('_', ' ')
        self._is_on, self._turn, self._shown = is_on, turn, False
        self.key = large(name, '', self._press, 'blue-grey-9').classes('switch')
        self.key.props('aria-pressed=false')

    async def _press(self) -> None:
        await self._turn(not self._is_on())

    def show(self) -> None:
        if self._is_on() != self._shown:
            self._shown = not self._shown
            self.key.props(
                f'color={"primary" if self._shown else "blue-grey-9"} '
                f'aria-pressed={"true" if self._shown else "false"}'
            )


class SignalKeys:
    """Outputs and inputs: a key for each on/off output, and the others as text."""

    def __init__(self, nodes: OperatorClient, command: Command):
        self._nodes, self._command = nodes, command
        self._told: MachineSignals | None = None
        with ui.element('div').classes('signals') as self._place:
            self._text = ui.label().props('data-mark="signals"').classes('small')
        self._place.set_visibility(False)  # until the machine has reported some
        self._keys: dict[str, Switch] = {}

    def _is_on(self, name: str) -> bool:
        signals: Any = self._nodes.signals
        return bool(signals.output_values[list(signals.outputs).index(name)])

    async def _turn(self, name: str, on: bool) -> None:
        switched = {'names': [name], 'values': [float(on)]}
        await self._command(asked(self._nodes.ask, 'switch_outputs', **switched))

    def show(self) -> None:
        signals = self._nodes.signals
        if signals is None or signals is self._told:
            return
        self._told = signals
        if not self._keys:
            with self._place:
                self._keys = {
                    name: Switch(name, partial(self._is_on, name), partial(self._turn, name))
                    for name, number in zip(signals.outputs, signals.output_is_number, strict=True)
                    if not number
                }
            self._place.set_visibility(True)
        for one in self._keys.values():
            one.show()
        outputs = zip(signals.outputs, signals.output_values, strict=True)
        told = [f'{name} {value:g}' for name, value in outputs if name not in self._keys]
        inputs = zip(signals.inputs, signals.input_values, strict=True)
        told += [f'{name} {"on" if value else "off"}' for name, value in inputs]
        self._text.set_text(', '.join(told).replace('_', ' '))


class Keys:
    """All keys of a page; ``in_sight`` sends commands that must not be executed late."""

    def __init__(
        self,
        desk: Desk,
        command: Command,
        in_sight: Command,
        may_set: Callable[[], bool],
        use: Callable[[Settings], Awaitable[None]],
    ):
        self._desk, self._command, self._use = desk, command, use
        with ui.element('div').classes('stops'):  # above every dialog
            self._stop = large('EMERGENCY STOP', colour='negative')
            self._stop.on(**pressing('emergency_stop'))
            self._hold = large('feed hold', colour='warning').on(**pressing('feed_hold'))
        start = large('cycle start', '', partial(in_sight, desk.cycle_start), 'positive')
        reset = partial(in_sight, partial(desk.trigger, 'reset'))
        keys = start.classes('moves'), large('reset', '', reset, 'blue-grey-7')
        self._switches = [
            *(self._switch(name) for name in SWITCHES),
            Switch('block delete', lambda: desk.settings.skip_blocks, self._skip_blocks),
        ]
        self._override = OverrideSlider(desk.nodes, may_set)
        self._spindle = SpindleKeys(desk.nodes, may_set)
        self._rapids = RapidKeys(desk.nodes, may_set)
        switches = (one.key for one in self._switches)
        rows = *self._rapids.keys.values(), *self._spindle.keys
        self._elements = (*keys, *switches, *self._override.elements, *rows)
        ui.context.client.on_connect(self._override.show_again)

    def _switch(self, name: str) -> Switch:
        async def turn(on: bool) -> None:
            await self._command(partial(self._desk.set_switch, name, on))

        return Switch(name, lambda: self._desk.switched[name], turn)

    async def _skip_blocks(self, on: bool) -> None:
        await self._use(replace(self._desk.settings, skip_blocks=on))

    def allow(self, in_charge: bool, trusted: bool) -> None:
        """Enable the keys of the page in charge; any page with the token may stop or hold."""
        for element in self._elements:
            element.set_enabled(in_charge)
        for element in (self._stop, self._hold):
            element.set_enabled(trusted)

    def show(self) -> None:
        for switch in self._switches:
            switch.show()
        self._override.show()
        self._spindle.show()
        self._rapids.show()
