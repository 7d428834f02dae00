"""Words that move the tool, alone or with the axis words of their block."""

from collections.abc import Sequence

import numpy as np

from cnc_interp.core import MINUTE, DependsOn
from cnc_interp.program.blocks.functions import acting
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.execution.setting_words import look_ahead
from cnc_interp.program.geometry.arcs import PLANES
from cnc_interp.program.motion import bezier, cycles, probing
from cnc_interp.program.motion.cycles import SiemensCycle
from cnc_interp.program.motion.probing import Probe
from cnc_interp.program.motion.thread_cycle import cut_thread
from cnc_interp.program.text import code_tables as codes
from cnc_interp.program.text.control_traits import FANUC, PLAIN, SIEMENS
from cnc_interp.program.text.words import BlockWords


def dwell(at: Execution, code: str, words: BlockWords) -> None:
    """Process G4, a dwell; P, X, F or U give its time, or S its spindle revolutions."""
    given = at.times
    at.mover.end_corner()
    moves = not words.values.keys().isdisjoint(at.mover.frames.letters)
    at.demand(not moves, 'a dwell and a motion in one block; write two lines', code)
    at.splines.stop_here()
    letter = next(iter(given), '')
    seconds = given.get(letter, 0.0)
    if letter == 'S':
        at.demand(
            at.mover.spindle_speed > 0.0,
            'counts turns of the spindle; write S and M3 first',
            'G4 S',
        )
        seconds *= MINUTE / at.mover.spindle_speed
    at.rest_for(code, seconds, words.texts.get('P', '') if letter == 'P' else '.')


def tilt(at: Execution, code: str, words: BlockWords) -> None:
    at.mover.demand_no_scale(code)
    at.plane.execute(code, words)


def thread(at: Execution, code: str, words: BlockWords) -> None:
    """Process the threads G33, G33.1 (which returns) and Fanuc's G32; K or F is the pitch."""
    mover, letter = at.mover, 'F' if code == 'G32' else 'K'
    at.refuse_if(
        code == 'G32' and mover.dialect not in (FANUC, PLAIN),
        'a thread of Fanuc; write G33 with K',
        code,
    )
    at.demand(
        mover.follows,
        'the spindle has no encoder; name the input spindle_angle in the machine file',
        code,
    )
    mover.end_corner()
    at.splines.stop_here()
    if code == codes.THREAD_CYCLE:
        cut_thread(mover, words)
        mover.motion = None
        return
    pitch = words.values.pop(letter, 0.0) * mover.unit
    at.demand(pitch > 0.0, f'needs {letter}, the travel per turn', code)
    target = mover.frames.point(mover.target(words)[:3])
    if code == 'G32' and (way := np.abs(target - mover.point)).any():
        pitch *= float(np.linalg.norm(way)) / way.max()  # F counts along the longest axis
    mover.in_step(code, target, pitch, code == 'G33.1')
    mover.motion = None  # modal on controls; here each line must repeat it


def probe(at: Execution, code: str, words: BlockWords) -> None:
    """Process the probing moves G38.2 to G38.5 and G31, which begin and end at rest."""
    mover = at.mover
    at.refuse_if(
        at.targets.start.line and not at.targets.start.passes,
        'the start line comes after a probe; start at the top',
        code,
    )
    point = probing.target_of(code, words, mover, at.signals)
    mover.end_corner()
    at.splines.stop_here()
    ready, _ = acting(at.signals, [probing.CODES[code].word], {}, at.fault)
    at.act(ready)
    mover.go(point, mover.rotary, rapid=False)
    at.splines.stop_here()
    if code.startswith('G38'):
        mover.motion = None
    mover.probed = probing.answer(mover, True)
    if at.is_live:
        at.probe = Probe(code, at.flow.main_line)
    else:
        at.notice(code, probing.ASSUMED)


def spline(at: Execution, code: str, words: BlockWords) -> None:
    """Process G5 and G5.1, which are splines of LinuxCNC or look-ahead switches."""
    mover = at.mover
    if not codes.SPLINE_LETTERS & words.values.keys() or mover.dialect in (FANUC, SIEMENS):
        look_ahead(at, code, words)
        return
    if mover.radius_code or mover.polar or at.cycle is not None:
        raise at.fault('a spline needs G40, G15 and G80 before it', code)
    at.splines.end()
    mover.end_corner()
    mover.motion = None  # modal on LinuxCNC; here each line must repeat it
    bezier.go_along(mover, code, words)


def move(at: Execution, words: BlockWords, feed_given: bool) -> None:
    mover, values = at.mover, words.values
    machine = 'G53' in words.g and not {'G28', 'G30'} & set(words.g)
    axes = not values.keys().isdisjoint(mover.frames.letters)
    at.refuse_if(
        machine and axes and mover.incremental and mover.dialect is not SIEMENS,
        'with G91 Fanuc leaves it out, LinuxCNC refuses it; write G90',
        'G53',
    )
    if at.cycle is not None and axes:
        at.demand(not machine, 'machine coordinates in a canned cycle; write G80 first', 'G53')
        at.cycle.drill(mover, words, feed_given)
    elif at.cycle is None and not at.splines.take(words, feed_given):
        mover.move(words, feed_given, machine)
    for letter in list(values):
        if letter == 'H' and mover.frames.length:
            raise at.fault(
                'on Fanuc it changes the tool length; write G43 with it, or leave it out',
                words.texts['H'],
            )
        if at.signals.uses(letter):
            continue
        if letter == 'E' and codes.EXTRUDING.isdisjoint(words.g):
            why = 'a fixture offset on Fadal; write G54 to G59, or leave it out'
            raise at.fault(why, words.texts['E'], DependsOn.LINE)
        if letter in 'STDHE':
            at.notice(letter, 'no effect, it does not move the tool')
        elif letter in 'ABCUVW':
            raise at.fault(mover.why_not(letter), letter, DependsOn.LEFT_OVER)
        elif letter == 'L' and len(values) == 1:
            why = 'is not supported; put it into this file'
            raise at.fault(f'the subprogram L{values[letter]:g} {why}', words.texts[letter])
        elif at.cycle is None or letter not in 'QRPKL':
            raise at.fault(
                'this word has no meaning here', words.texts[letter], DependsOn.LEFT_OVER
            )


def siemens_cycles(at: Execution, words: BlockWords) -> list[SiemensCycle]:
    mover, modal, found = at.mover, False, list[SiemensCycle]()
    if not words.keys:
        return found
    for key, given in words.keys:
        if key == 'MCALL':
            modal, at.called = True, None
        elif key in cycles.SIEMENS:
            found.append(SiemensCycle(key, given, mover))
        elif key in cycles.PATTERNS:
            drill_pattern(at, key, given)
    words.keys[:] = [key for key in words.keys if key[0] not in cycles.SIEMENS_WORDS]
    if modal and found:
        at.called = found.pop()
    return found


def drill_pattern(at: Execution, key: str, given: Sequence[float | None]) -> None:
    mover = at.mover
    if at.called is None:
        raise at.fault('a pattern needs a modal cycle; write MCALL CYCLE81(...) first', key)
    for place in cycles.places_of(key, given, mover):
        target = mover.here()
        target[list(PLANES[mover.plane][:2])] = place
        mover.go(mover.frames.point(target[:3]), mover.rotary, rapid=True)
        at.called.make()
