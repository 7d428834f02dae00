"""The page: read-outs, machine, program, charts and keys of one browser tab."""

import time
from functools import partial
from typing import Any

from nicegui import events, ui

from cnc_interp.client.length_unit import INCHES, MILLIMETRES
from cnc_interp.client.setup_client import work_zero
from cnc_interp.description.urdf import describe_machine
from cnc_interp.machine_model.signals import TOWARD
from cnc_interp.page.contact import AGAIN, LATE, NO_TOKEN, VIEW_ONLY, Access, Act, Contact, key
from cnc_interp.page.desk import Desk
from cnc_interp.page.dialogs import SettingsDialog, SetupDialog, keyboard_list
from cnc_interp.page.hand_motion import JogPad, PoseField, TouchOffField
from cnc_interp.page.keys import Keys, SignalKeys
from cnc_interp.page.probe_dialog import ProbeDialog
from cnc_interp.page.program_column import Listing, MdiField, StartField
from cnc_interp.page.program_dialogs import EditorDialog, FolderDialog, MacroKeys
from cnc_interp.page.program_folder import LONGEST_PROGRAM
from cnc_interp.page.readings import (
    NOTHING,
    Charts,
    Messages,
    ShownUnit,
    change_text,
    progress,
    readings,
)
from cnc_interp.page.scene import SCALE, VIEWS, MachineView
from cnc_interp.page.times_dialog import TimesDialog
from cnc_interp.settings.options import Settings
from cnc_interp.wire.run_messages import in_program

#: Least time between shown states [s]; number of states between updates of the charts.
PACE, CHART_EVERY = 0.1, 4
EARLY = 0.02  #: A state may be shown this much early [s].
STALE = 0.5  #: Interval of updates if no state arrives [s].


outlined = partial(key, colour='primary', look='dense outline')


def marked(element: Any, name: str) -> Any:
    return element.props(f'data-mark="{name}"')


class Page:
    _listing: Listing
    _mdi: MdiField
    _probe: ProbeDialog
    _folder: FolderDialog
    _editor: EditorDialog
    _times: TimesDialog

    def __init__(self, desk: Desk, access: Access, tab: str, trusted: bool, why: str = ''):
        self._why = why  # the page may not send commands; empty if it may
        self._desk, self._access, self._tab, self._trusted = desk, access, tab, trusted
        assert desk.machine is not None  # a page is made once it is known
        self._machine = desk.machine
        self._labels: dict[str, Any] = {}
        self._shown: dict[str, Any] = {}
        self._zeros: list[Any] = []
        self._unit = ShownUnit()
        self._count, self._shown_at = 0, 0.0
        self._waits = self._at_hit = False
        access.enter(tab, trusted)
        self._contact = Contact(self._stop_with)
        with ui.element('div').classes('panel'):
            self._build_head()
            with ui.element('div').classes('dro'):
                self._build_readouts()
            with ui.element('div').classes('view'):
                self._build_view()
            with ui.element('div').classes('text'):
                self._build_program()
            with ui.element('div').classes('keys'):
                self._keys = Keys(
                    desk,
                    self._command,
                    self._command_in_sight,
                    may_set=lambda: self._allowed() and self._in_sight(),
                    use=self._use,
                )
            with ui.element('div').classes('charts'):
                self._charts = Charts(self._machine.axis_names, self._unit)
        self._settings = SettingsDialog(self._use)
        self._setup = SetupDialog(desk.setup, self._unit, self._command_in_sight, self._mdi.give)
        self._keyboard = keyboard_list()
        ui.on('inch', self._use_unit)
        ui.on('pick_point', self._pick_point)
        ui.run_javascript('preferences.apply()')
        ui.timer(STALE, self._show)
        self._client = ui.context.client
        self._client.on_connect(self._listing.show_again)
        desk.pages.add(self._show_state)
        self._client.on_delete(lambda: desk.pages.discard(self._show_state))

    def _use_unit(self, event: events.GenericEventArguments) -> None:
        is_inch, texts = event.args
        self._unit.use(INCHES if is_inch else MILLIMETRES, texts)

    # Building -----------------------------------------------------------------------------------

    def _label(self, name: str, kind: str = 'value') -> Any:
        self._labels[name] = marked(ui.label(NOTHING).classes(kind), name)
        return self._labels[name]

    def _build_head(self) -> None:
        with ui.element('div').classes('head'):
            ui.html('<b>cnc_interp</b>', sanitize=False)
            self._label('state', 'state')
            self._label('why', 'grow')
            marked(ui.element('div').classes('contact'), 'contact')
            marked(ui.label(self._why).classes('refused'), 'refused')
            keyboard = outlined('?', 'keyboard', lambda: self._keyboard.open())
            keyboard.tooltip('keyboard')
            reach = outlined('MDI', 'to the MDI field').classes('reach')
            reach.on('click', js_handler='() => keyboard.reach("mdi")')
            for mark in ('inch', 'light'):
                outlined(mark).on('click', js_handler=f'() => preferences.toggle("{mark}")')
            self._label('rights', '')
            self._take = outlined('take over', act=self._take_over)

    def _build_readouts(self) -> None:
        with ui.element('div').classes('two'):
            self._label('setup', 'work')
            ui.label('machine').classes('heading')
        named, axes = self._machine.program_names, self._machine.axis_names
        for name in dict.fromkeys((*named, *axes)):
            with ui.element('div').classes('place'):
                ui.label(name).classes('name')
                if name in (*named, *self._machine.extra_names):  # joints of an arm have no words
                    self._label(f'work {name}').tooltip('in the program, mm or °')
                else:
                    ui.label()
                if name in axes:
                    self._label(f'axis {name}', 'at').tooltip('of the machine, mm or °')
                if name in named:  # others have no work offset
                    self._zero_key(name)
        with ui.element('div').classes('change') as self._change:
            self._label('offset change', 'grow small')
            undo = key('undo', 'undo offset', self._undo).classes('changes')
            self._zeros.append(undo)
        self._change.set_visibility(False)
        for title, mark, letters in (
            ('tip without offsets, mm', 'tip', 'XYZ'),
            ('tool axis', 'tool', 'IJK'),
        ):
            self._unit.label(title).classes('heading')
            with ui.element('div').classes('three'):
                for letter, name in zip(letters, 'xyz', strict=True):
                    with ui.element('div'):
                        ui.label(letter).classes('name')
                        self._label(f'{mark} {name}')
        ui.label('feed').classes('heading')
        self._pair('actual', 'feed', 'mm/min', 'pair feed')
        self._pair('programmed', 'programmed', 'mm/min')
        self._pair('spindle', 'spindle', '')
        ui.label('run').classes('heading')
        self._pair('distance to go', 'to go', 'mm')
        with ui.element('div').classes('two'):
            for title, name in (
                ('line', 'line'),
                ('done', 'progress'),
                ('time', 'elapsed'),
                ('time left', 'left'),
                ('buffer', 'buffer'),
                ('lowest', 'least'),
                ('underruns', 'missed'),
                ('contour', 'contour'),
            ):
                self._pair(title, name, '')
        with ui.element('div') as self._compensation:
            self._pair('largest contour error', 'largest contour', '')
            self._pair('without compensation', 'uncompensated', '')
        self._compensation.set_visibility(False)

    def _zero_key(self, letter: str) -> None:
        act = partial(self._command_in_sight, partial(self._desk.zero, letter))
        made = key('0', f'zero {letter}', act, 'primary', 'dense flat').classes('changes')
        made.tooltip(f'set the coordinate {letter} of this place to 0')
        self._zeros.append(made)

    async def _undo(self) -> None:
        await self._command_in_sight(
            partial(self._desk.setup.undo, self._shown.get('changes', ()))
        )

    def _show_change(self) -> None:
        changes = self._desk.setup.changes
        news = self._changed('changes', changes)
        if self._changed('change unit', self._unit.now) or news:
            told = '; '.join(one.text(self._unit.now) for one in changes)
            self._labels['offset change'].set_text(told)
            self._change.set_visibility(bool(changes))

    def _pair(self, title: str, name: str, unit: str, kind: str = 'pair') -> None:
        with ui.element('div').classes(kind if ' ' in kind else 'pair'):
            ui.label(title).classes('name')
            self._label(name)
            self._unit.label(unit).classes('unit' if unit else '')

    def _build_view(self) -> None:
        self._view = view = MachineView(describe_machine(self._machine, self._desk.bodies))
        with ui.element('div').classes('over') as self._over:
            looks = ui.toggle(['part', 'machine'], value='part')
            looks.on_value_change(lambda event: view.look_at_part(event.value == 'part'))
            marked(looks.props('dense no-caps unelevated color=blue-grey-9'), 'look')
            for name in VIEWS:
                key(name, f'from {name}', partial(view.look_from, name), 'blue-grey-9')
        self._build_hand_motion()
        colours = ', '.join(f'rgb{colour}' for colour in SCALE)
        with ui.element('div').classes('legend'):
            shade = f'background: linear-gradient(90deg, {colours})'
            ui.html(f'<i style="{shade}"></i>', sanitize=False)
            self._label('scale', '')
        self._label('start', 'told')
        with ui.element('div').classes('told hit') as self._hit:
            self._label('hit', 'grow')
            self._looks = key('show where', 'show hit', self._toggle_hit, 'red-10')
        for hidden in (self._hit, self._looks):
            hidden.set_visibility(False)

    def _build_hand_motion(self) -> None:
        nodes, setup, command = self._desk.nodes, self._desk.setup, self._command_in_sight
        pad = JogPad(self._machine, nodes, lambda: self._in_charge, self._unit, command)
        self._pad = pad
        axes = self._machine.program_names
        pose = PoseField(nodes, lambda: pad.speed, axes, self._unit, command)
        touch = TouchOffField(setup, axes, self._unit, command)
        with self._over:
            key('jog', 'jog', pad.toggle, 'blue-grey-9')
            key('go to', 'pose', partial(pose.toggle, touch), 'blue-grey-9')
            key('touch off', 'show touch off', partial(touch.toggle, pose), 'blue-grey-9')
            key('offsets', 'offsets', lambda: self._setup.open(), 'blue-grey-9')
            if TOWARD in self._machine.signals.words:
                key('probe', 'probe', lambda: self._probe.open(), 'blue-grey-9')

    def _build_program(self) -> None:
        desk = self._desk
        with ui.element('div').classes('title'):
            self._label('program', 'grow name')
        with ui.element('div').classes('title keyrow'):
            upload = ui.upload(
                on_upload=self._load, auto_upload=True, max_file_size=LONGEST_PROGRAM
            ).classes('hidden')
            upload.disable()  # until the page is in charge; a page without control cannot upload
            self._upload = upload
            self._loader = key('load', act=lambda: self._pick(waits=False))
            self._lister = key('programs', act=lambda: self._folder.open())
            self._editing = key('edit', act=lambda: self._editor.open())
            self._follower = key('queue next', act=lambda: self._pick(waits=True))
            self._checker = key('check', act=partial(self._command, desk.check))
            key('times', act=lambda: self._times.open())
            self._setter = key('settings', act=lambda: self._settings.open(desk.settings))
            self._follower.tooltip('choose a program that starts when the running one has ended')
        self._label('status', 'status small')
        with ui.element('div').classes('title') as self._next:
            self._label('waiting', 'grow small')
            outlined('clear queue', act=partial(self._command, desk.empty_queue))
        with ui.element('div').classes('bar'):
            self._bar = ui.element('div')
        self._listing = Listing()
        self._start = StartField(desk.choose_start, self._command)
        self._mdi = MdiField(desk.lines, desk.nodes.give_line, self._command_in_sight)
        self._probe = ProbeDialog(desk.nodes, desk.setup, self._unit, self._command_in_sight)
        self._signals = SignalKeys(desk.nodes, self._command_in_sight)
        self._macros = MacroKeys(desk, self._mdi.give)
        self._folder = FolderDialog(desk, self._command)
        self._editor = EditorDialog(desk, self._command)
        self._times = TimesDialog(desk, self._command)
        self._messages = Messages(self._desk.nodes.alarms)

    # Commands: every one is allowed or rejected here, on the server ----------------------------

    @property
    def _in_charge(self) -> bool:
        return self._trusted and self._access.is_in_charge(self._tab)

    async def _command(self, act: Act) -> None:
        if self._allowed():
            await self._do(act)

    async def _command_in_sight(self, act: Act) -> None:
        if self._in_sight():
            await self._command(act)

    def _in_sight(self) -> bool:
        if self._contact.age > LATE:
            ui.notify(AGAIN, type='warning')
            return False
        return True

    async def _stop_with(self, name: str) -> None:
        """Stop or hold, even if the request arrives late; the token is sufficient."""
        if self._trusted or self._allowed():
            await self._do(partial(self._desk.trigger, name))

    @staticmethod
    async def _do(act: Act) -> None:
        answer = await act()
        if not answer.ok:
            ui.notify(answer.message, type='negative')

    def _allowed(self) -> bool:
        if not self._in_charge:
            ui.notify(VIEW_ONLY if self._trusted else self._why or NO_TOKEN, type='warning')
        return self._in_charge

    def _pick(self, waits: bool) -> None:
        self._waits = waits
        self._upload.run_method('pickFiles')

    async def _load(self, event: events.UploadEventArguments) -> None:
        text = (await event.file.read()).decode('utf-8-sig', errors='replace')
        act = self._desk.queue if self._waits else self._desk.load
        await self._command(partial(act, event.file.name, text))
        self._upload.reset()

    async def _use(self, settings: Settings) -> None:
        await self._command(partial(self._desk.choose, settings))

    def _take_over(self) -> None:
        if self._trusted:
            self._access.take_over(self._tab)
        else:
            ui.notify(self._why or NO_TOKEN, type='warning')

    def _pick_point(self, event: events.GenericEventArguments) -> None:
        if line := self._desk.drawn_line(int(event.args['point'])):
            ui.run_javascript(f'listing.choose({line})')

    # Showing ------------------------------------------------------------------------------------

    def _changed(self, what: str, value: Any) -> bool:
        if self._shown.get(what) == value:
            return False
        self._shown[what] = value
        return True

    def _show_state(self) -> None:
        if time.monotonic() - self._shown_at > PACE - EARLY:
            with self._client:
                self._show()

    def _show(self) -> None:
        """Update the page; only changes are sent, and only while the browser keeps up."""
        if not self._contact.is_followed:
            return
        self._shown_at = time.monotonic()
        desk = self._desk
        state, job = desk.nodes.state, desk.job
        words = readings(desk, self._unit.now)
        words['program'] = job.name if job else 'no program'
        if self._changed('failed', job is not None and job.failed):
            failed = ' failed' if self._shown['failed'] else ''
            self._labels['status'].classes(replace=f'status small{failed}')
        words['status'] = job.status if job else 'press load to choose a program'
        words['start'] = self._start_text()
        bodies, words['hit'] = desk.hit()
        if self._at_hit and desk.planned_hit is not None:
            words['hit'] = f'the picture shows the hit, not where the machine is: {words["hit"]}'
        self._view.mark(bodies, desk.tool)
        if self._changed('hits', bool(bodies)):
            self._hit.set_visibility(bool(bodies))
        if self._changed('planned hit', desk.planned_hit):
            self._looks.set_visibility(desk.planned_hit is not None)
            self._at_hit = False
        words['waiting'] = f'next: {desk.nodes.waiting}' if desk.nodes.waiting else ''
        for name, text in words.items():
            if self._changed(name, text):
                self._labels[name].set_text(text)
        if self._changed('compensated', desk.nodes.uncompensated is not None):
            self._compensation.set_visibility(self._shown['compensated'])
        if self._changed('state colour', words['state']):
            colour = 'silent' if words['state'].startswith('no') else words['state']
            self._labels['state'].classes(replace=f'state {colour}')
        if self._changed('some wait', bool(desk.nodes.waiting)):
            self._next.set_visibility(bool(desk.nodes.waiting))
        self._show_rights()
        self._show_change()
        self._show_lists()
        if state is not None:
            hit = desk.planned_hit if self._at_hit else None
            places = state.positions if hit is None else hit.positions
            self._view.show(dict(zip(self._machine.joint_names, places, strict=False)))
            if desk.setup.table is not None:
                where = work_zero(desk.setup.table, desk.setup.setup, desk.offset())
                self._view.show_zero(*where)
            if job is not None and job.failed and job.plan is None:
                self._view.clear_path()
                if self._changed('scale', ''):
                    self._labels['scale'].set_text('no path: the program was refused')
            if job is not None and job.plan is not None:
                self._view.show_path(desk.tube_number, job.plan)
                if desk.shown_plan(state) is not None:
                    self._view.show_done(desk.drawn_until(state.path_position))
                    self._view.show_stage(job.plan.stage_at(state.path_position))
                unit = self._unit.now
                top = unit.per_minute(job.plan.usual_feed)
                if self._changed('scale', f'0 to {top:.0f} {unit.name}/min, planned feed'):
                    self._labels['scale'].set_text(self._shown['scale'])
        self._count += 1
        newest = desk.history[-1].time if desk.history else 0.0
        drawn = newest, self._unit.now, job and job.plan and job.number
        if self._count % CHART_EVERY == 0 and self._changed('charts', drawn):
            self._charts.show(desk)

    def _toggle_hit(self) -> None:
        """Switch between drawing the machine at the first hit of the program and as it is."""
        self._at_hit = not self._at_hit
        self._show()

    def _start_text(self) -> str:
        """Return a note for the operator about the start; empty at the top of a program."""
        way, desk = self._desk.way_ahead(), self._desk
        self._view.show_way(way)
        start = desk.start.line, desk.start.which
        if self._changed('laid', (desk.laid, *start)):
            self._start.fill(*start)
        if (tool := desk.nodes.tool_wanted) is not None:
            return change_text(tool, desk.setup.setup, self._unit.now)
        if in_program(desk.nodes.state):
            return way.text if way is not None else ''
        return desk.start.text

    def _show_rights(self) -> None:
        rights = 'in charge' if self._in_charge else 'view only'
        if self._changed('rights', rights):
            self._labels['rights'].set_text(rights)
            self._take.set_visibility(not self._in_charge)
            buttons = (self._loader, self._lister, self._editing, self._follower, self._checker)
            fields = (self._upload, *self._start.keys, self._mdi.field)
            for element in (*buttons, self._setter, *fields, *self._zeros, *self._macros.keys):
                element.set_enabled(self._in_charge)
            self._keys.allow(self._in_charge, self._trusted)
        self._keys.show()

    def _show_lists(self) -> None:
        desk, state = self._desk, self._desk.nodes.state
        plan = desk.shown_plan(state) if state is not None else None
        line = state.line_number if state is not None and plan is not None else 0
        self._listing.show(desk.job, line, desk.start_line())
        share = progress(state, plan) if state is not None else 0.0
        if self._changed('bar', round(share, 3)):
            self._bar.style(f'transform: scaleX({share:.3f})')
        self._signals.show()
        self._messages.show()
        self._mdi.show(*desk.modes())
        self._editor.show()
        self._pad.show(state)
