"""Words that set modes, compensation, tolerances and frames, and words without effect."""

import numpy as np

from cnc_interp.core import DEG, DependsOn
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.execution.setup_words import cutter_of, keep_shift
from cnc_interp.program.geometry.arcs import PLANES
from cnc_interp.program.geometry.contact_normal import ToolShape
from cnc_interp.program.modal.modal_words import MODES, SETTINGS
from cnc_interp.program.modal.state import FARTHEST
from cnc_interp.program.motion.cycles import TAPPING, CannedCycle
from cnc_interp.program.text import code_tables as codes
from cnc_interp.program.text.words import BlockWords
from cnc_interp.settings.options import Settings

#: Default tolerances [m]; no notice is given if the program replaces them.
USUAL = Settings().contour_tolerance, Settings().orientation_tolerance


def set_mode(at: Execution, code: str, _: BlockWords) -> None:
    name, value = SETTINGS[code]
    if other := at.set_here.get(name):
        raise at.fault(f'{other} is in the same block; keep one of them', code)
    at.set_here[name] = code
    setattr(at.mover, name, value)
    at.mover.centres_open &= name != 'centre_absolute'
    if name == 'motion':
        at.cycle = None
        at.splines.end()


def look_ahead(at: Execution, code: str, words: BlockWords) -> None:
    """Process the look-ahead switches G5, G5.1 and G8; reject them with letters of a spline."""
    if codes.SPLINE_LETTERS & words.values.keys():
        refuse(at, code, words)
    words.take(codes.LOOK_AHEAD[code])
    at.notice(code, 'no effect, the path is always smoothed within the tolerances')


def refuse(at: Execution, code: str, _: BlockWords) -> None:
    raise at.fault(
        codes.REFUSED_G.get(code, 'this G code is not supported; post without it'),
        code,
        DependsOn.LINE,
    )


def refuse_lathe(at: Execution, code: str, words: BlockWords) -> None:
    values = words.values
    contour = {'P', 'Q'} <= values.keys() and 'Z' not in values
    at.refuse_if(
        contour or ('U' in values and 'U' not in at.mover.extra_letters),
        'a cycle of a lathe; lathe programs are not read',
        code,
        DependsOn.LINE,
    )


def begin_cycle(at: Execution, code: str, _: BlockWords) -> None:
    at.mover.demand_no_scale(code, PLANES[at.mover.plane][2])
    if at.cycle is None:
        at.cycle = CannedCycle(code, at.level())
    at.cycle.code = code
    if code in TAPPING:
        at.mover.tell_tapping(code)


def end_cycle(at: Execution, *_: object) -> None:
    at.cycle = None


def end_plane(at: Execution, *_: object) -> None:
    at.plane.cancel()


def begin_polar(at: Execution, code: str, _: BlockWords) -> None:
    at.demand(
        at.mover.dialect in MODES['polar'].dialects,
        'only polar coordinates of Fanuc are supported; post with X and Y',
        code,
    )
    at.mover.polar = True


def no_effect(at: Execution, code: str, words: BlockWords) -> None:
    """Process words without effect; reject them if their letters give them another meaning."""
    mover = at.mover
    letters, why = codes.OTHER_MEANING.get(code, ('', ''))
    if found := set(letters) & words.values.keys():
        raise at.fault(why, f'{code} {words.texts[min(found)]}')
    at.refuse_if(
        code == 'G54.2' and words.values.get('P'),
        'a dynamic offset is not supported; write G54.2 P0',
        code,
    )
    if code == 'G15' and mover.polar:
        mover.polar = False
        return
    words.take(codes.IDLE_LETTERS.get(code, ''))
    if code in ('G96', 'G97'):
        mover.by_surface_speed = code == 'G96'
    if code not in at.signals.words:
        at.notice(code, codes.HARMLESS_G[code])


def cutter_radius(at: Execution, code: str, words: BlockWords) -> None:
    mover = at.mover
    at.refuse_if(
        not at.whole and code != 'G40', 'needs the lines after it; run it in a program', code
    )
    if code == 'G40':
        if not mover.radius_code:
            at.notice(code, 'nothing to switch off')
        mover.end_radius()
        return
    at.demand(not mover.radius_code, f'{mover.radius_code} is on; write G40 first', code)
    if code in ('G41.2', 'G42.2') or (mover.along_normals and code in ('G41', 'G42')):
        _contact_normals(at, code, words)
        return
    named = words.values.get('D')
    if code in ('G41.1', 'G42.1'):
        words.values.pop('D', None)
        if named is None:
            raise at.fault('give the diameter of the cutter as D', code)
        radius = 0.5 * named * mover.unit
    else:
        radius = cutter_of(at, words).radius
    at.demand(
        0.0 <= abs(radius) < FARTHEST,
        'a radius beyond 100,000 mm; correct it',
        words.texts.get('D', code),
    )
    mover.begin_radius(code, radius if code.startswith('G41') else -radius)


def _contact_normals(at: Execution, code: str, words: BlockWords) -> None:
    """Process G41.2 and G42.2; D, R: radii of the tool in use; Q, P: of the programmed tool."""
    mover, values, chosen = at.mover, words.values, cutter_of(at, words)
    corner = chosen.corner_radius
    if 'R' in values:
        corner = values.pop('R') * mover.unit
    if corner is None:
        raise at.fault(
            'the corner radius of the tool is not known; write R (0: flat end, '
            'the radius: ball), or corner_radius in the setup',
            code,
        )
    cutter = ToolShape(chosen.radius, corner)
    _demand_corner(at, cutter, words.texts.get('R', code))
    at.demand(
        ('Q' in values) == ('P' in values),
        'Q is the radius and P the corner radius of the tool of the program; write both',
        code,
    )
    if 'Q' in values:
        posted = ToolShape(values.pop('Q') * mover.unit, values.pop('P') * mover.unit)
        _demand_corner(at, posted, words.texts['P'])
        cutter = cutter.beyond(posted)
    mover.begin_contact(code, cutter)


def _demand_corner(at: Execution, cutter: ToolShape, word: str) -> None:
    if not 0.0 <= cutter.corner_radius <= cutter.radius < FARTHEST:
        radius = cutter.radius / at.mover.unit
        raise at.fault(f'the corner radius must be from 0 to the radius, {radius:g}', word)


def path_tolerance(at: Execution, words: BlockWords) -> None:
    tolerance = words.values.pop('P', None)
    q = words.values.pop('Q', None)  # ignored: the compressor stays within P in any case
    if q is not None and (tolerance is None or not q >= 0.0):
        raise at.fault('write G64 P Q: P is the tolerance, Q not below 0', words.texts['Q'])
    tolerance = tolerance or None  # P0 sets no tolerance, as in LinuxCNC
    if tolerance is not None and not 0.0 < tolerance * at.mover.unit < FARTHEST:
        raise at.fault('the tolerance must be greater than zero', words.texts['P'])
    tolerances(at, 'G64 P', tolerance, tolerance)


def tolerances(at: Execution, word: str, contour: float | None, orientation: float | None) -> None:
    """Set tolerances in program units; None restores the value of the settings."""
    mover, settings = at.mover, at.mover.settings
    if settings.force_tolerances:
        if contour is not None or orientation is not None:
            at.notice(word, "ignored, the command's tolerances are forced")
        return
    wanted = settings.contour_tolerance, settings.orientation_tolerance
    if wanted != USUAL and (contour or orientation):
        at.notice(
            word,
            "the program's tolerance is used instead of that of the command; "
            'to change this: --force-tolerances',
        )
    mover.contour = settings.contour_tolerance if contour is None else contour * mover.unit
    mover.orientation = (
        settings.orientation_tolerance if orientation is None else orientation * mover.unit
    )


def turn_frame(at: Execution, key: str, words: BlockWords) -> None:
    mover = at.mover
    frames, before = mover.frames, mover.here()
    if not key.startswith('A'):
        frames.reset_frame()
        frames.reset_scale()
    elif frames.scales:
        raise at.fault('comes after MIRROR or SCALE; write it before them', key)
    taken = {letter: words.values.pop(letter, 0.0) for letter in 'XYZ'}
    if key.endswith('TRANS'):
        frames.move(np.array([taken[letter] * mover.unit for letter in 'XYZ']))
    else:
        if 'RPL' in dict(words.sets):
            taken['XYZ'[PLANES[mover.plane][2]]] = dict(words.sets)['RPL']
        frames.rotate({letter: angle * DEG for letter, angle in taken.items() if angle})
    frames.update()
    if key.endswith('TRANS'):
        keep_shift(at, before)


def choose_interpolation(at: Execution, key: str, _: BlockWords) -> None:
    mover = at.mover
    if mover.settings.interpolation == 'auto' and mover.rotary_letters:
        mover.great_circle = MODES['great_circle'].codes[key]
    else:
        at.notice(key, 'ignored, the interpolation is fixed')


def switch_tcp_off(at: Execution, *_: object) -> None:
    at.mover.switch_tcp('')


def use_machine_coordinates(_: Execution, __: str, words: BlockWords) -> None:
    words.g.append('G53')


def high_speed_settings(at: Execution, key: str, words: BlockWords) -> None:
    """Process CYCLE832, which sets a tolerance and replaces exact stops by smoothing."""
    mover, given = at.mover, dict(words.keys)[key]
    tolerance = given[0] if given and given[0] else None
    if tolerance is not None and not 0.0 < tolerance * mover.unit < FARTHEST:
        raise at.fault('the tolerance must be greater than zero', key)
    tolerances(at, key, tolerance, tolerance)
    mover.stop_always = mover.stop_always and tolerance is None


def swivel(at: Execution, key: str, words: BlockWords) -> None:
    given = dict(words.keys)[key]
    at.mover.demand_no_scale(key)
    if any(given):
        at.plane.swivel(given, words)
    else:
        at.plane.cancel()


def choose_compensation(at: Execution, key: str, _: BlockWords) -> None:
    at.mover.along_normals = codes.RADIUS_KEYS[key]


def idle_key(at: Execution, key: str, _: BlockWords) -> None:
    at.notice(key, 'no effect, it does not move the tool')


def nothing(*_: object) -> None:
    """Do nothing; a later phase uses the word together with others."""
