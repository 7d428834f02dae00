"""The threading cycle of LinuxCNC (G76): passes in step with the spindle, each deeper."""

from math import copysign, isclose, radians, tan

import numpy as np

from cnc_interp.program.motion.block_motion import Mover
from cnc_interp.program.text.words import BlockWords

CODE = 'G76'
MOST_PASSES = 1000


def cut_thread(mover: Mover, words: BlockWords) -> None:
    """Cut a thread beside the line along Z; I is the crest, J the first cut, K the full depth.

    Pass n cuts to the depth J n^(1/R), and is shifted along Z according to the angle Q.
    """
    values, unit = words.values, mover.unit
    mover.demand(mover.plane == 'G18', 'cuts along Z, away from X; write G18 first', CODE)
    if missing := [letter for letter in 'PZIJK' if letter not in values]:
        raise mover.fault(f'needs {" ".join(missing)}', CODE)
    values.pop('E', None)
    mover.demand(
        values.pop('L', 0.0) == 0.0,
        'tapers are not supported; write L0, and let the thread end in a groove',
        CODE,
    )
    end = mover.target(
        BlockWords(values={'Z': values.pop('Z')}, ways=words.ways, texts=words.texts)
    )[:3]
    pitch, crest, first, full = (values.pop(letter) * unit for letter in 'PIJK')
    slower, angle, springs = (values.pop(letter, least) for letter, least in zip('RQH', (1, 0, 0)))
    mover.demand(
        pitch > 0.0 and crest != 0.0 and 0.0 < first < full,
        'needs P above 0, I, and J above 0 and below K',
        CODE,
    )
    mover.demand(
        slower >= 1.0 and 0.0 <= angle <= 80.0 and springs in range(MOST_PASSES),
        'needs R from 1, Q from 0 to 80 and H a whole number',
        CODE,
    )
    mover.demand(
        (full / first) ** slower <= MOST_PASSES,
        f'J and R make more than {MOST_PASSES} passes; cut deeper',
        CODE,
    )
    here, cuts = mover.here()[:3], [first]
    while (cut := first * (len(cuts) + 1) ** (1.0 / slower)) < full and not isclose(cut, full):
        cuts.append(cut)
    slope = copysign(tan(radians(angle)), here[2] - end[2])
    for cut in [*cuts, *[full] * (1 + round(springs))]:
        side = crest + copysign(cut, crest)
        back, enters, leaves = copysign(full - cut, -crest), cut * slope, (full - cut) * slope
        for rapid, x, z in (
            (True, back, here[2] - enters),
            (True, side, here[2] - enters),
            (False, side, end[2] + leaves),
            (True, back, end[2] + leaves),
        ):
            place = mover.frames.point(np.array([here[0] + x, here[1], z]))
            if rapid:
                mover.go(place, mover.rotary, rapid=True)
            else:
                mover.targets.stop_here()
                mover.in_step(CODE, place, pitch, False)
