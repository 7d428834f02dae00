"""The probing cycles: what they find with a probe that is not exact, and what they leave alone."""

import re
from dataclasses import replace

import numpy as np
import pytest

from cnc_interp.core import DEG, ProgramError
from cnc_interp.machine.simulated_probe import distance, read_surfaces
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import signals
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.job import JobSetup, Tool
from cnc_interp.program.reading import MdiReader
from cnc_interp.settings.options import Settings

MACHINE = replace(Machine.load('xyz'), signals=signals({'signals': 'milling'}))
TRANSFORM = Transform.of(MACHINE)
BALL, UM = 1.5e-3, 1e-6
NOISE, LATE, STOP = 1.0 * UM, 1e-3, 0.15e-3  #: Of the place; of the answer [s]; way of a stop [m].


class Bench:
    """A machine that runs lines by hand; its probe touches surfaces."""

    def __init__(self, tmp_path, surfaces, setup=None):
        file = tmp_path / 'part.yaml'
        file.write_text('surfaces:\n' + ''.join(f'  - {{{each}}}\n' for each in surfaces))
        _, self.surfaces, _ = read_surfaces(file)
        self.setup, self.random = setup or JobSetup(), np.random.default_rng(3)
        self.moves = []

    def gap(self, tip):
        centre = tip + [0.0, 0.0, BALL]
        return min(distance(row, centre) for row in self.surfaces) - BALL

    def answers(self, probe, start, end, feed):
        """Return where the probe answers on a line, or None, and where the axes rest then."""
        touch = 1.0 if probe.code in ('G38.2', 'G38.3') else -1.0
        shares = np.linspace(0.0, 1.0, 20_001)
        gaps = np.array([self.gap(start + s * (end - start)) for s in shares[::50]]) * touch
        hits = np.flatnonzero(gaps <= 0.0)
        if not len(hits):
            return end, None
        low, high = max(hits[0] - 1, 0) / 400, hits[0] / 400
        assert hits[0] > 0, 'the probe had answered before it moved'
        for _ in range(40):
            middle = (low + high) / 2
            inside = self.gap(start + middle * (end - start)) * touch <= 0.0
            low, high = (low, middle) if inside else (middle, high)
        way = end - start
        length = np.linalg.norm(way)
        late = feed * (LATE + 1e-3 * self.random.random()) + NOISE * self.random.standard_normal()
        at = start + way * (high + late / length)
        return at + way / length * STOP * feed / 5e-3, at

    def run(self, line, stands):
        reader = MdiReader(TRANSFORM, Settings())
        stream, at = reader.line(line, np.array(stands, dtype=float), self.setup), None
        while True:
            blocks = list(stream)
            tips = np.concatenate([part.tip for part in blocks])
            feeds = np.concatenate([part.feedrate for part in blocks])
            self.moves.append(tips)
            for change in stream.changes:
                self.setup = self.setup.changed(change.change)
            if stream.probe is None:
                self.told = stream.notices
                return tips[-1]
            stands, at = self.answers(stream.probe, tips[-2], tips[-1], feeds[-1])
            assert not stream.probe.fault(at is not None, False)
            stream.go_on(stands, at)

    def zero(self, letter):
        return self.setup.work_offsets['G54'][letter]


def test_a_bore_is_centred_within_a_micrometre(tmp_path):
    errors = []
    bench = Bench(tmp_path, ['bore: [12.3, -4.5, 0], radius_mm: 10'])
    for _ in range(20):
        bench.run('O<probe_bore> CALL [20] [3] [3] [300] [60]', [0.0115, -0.0052, -0.005])
        errors += [bench.zero('X') - 12.3e-3, bench.zero('Y') + 4.5e-3]
    assert np.sqrt(np.mean(np.square(errors))) < 1.0 * UM
    assert abs(diameter(bench) - 20.0) < 0.02  # both answers are late


def diameter(bench):
    (text,) = re.findall(r'diameter ([\d.]+) mm', bench.told[-1])
    return float(text)


def test_a_boss_is_centred_from_above(tmp_path):
    bench = Bench(tmp_path, ['boss: [-7, 3, 0], radius_mm: 12'])
    end = bench.run('O<probe_boss> CALL [24] [3] [4] [5] [300] [60]', [-0.0065, 0.0034, 0.002])
    assert abs(bench.zero('X') + 7e-3) < 3 * UM and abs(bench.zero('Y') - 3e-3) < 3 * UM
    assert np.allclose(end, [-0.007, 0.003, 0.002], atol=3 * UM)
    assert abs(diameter(bench) - 24.0) < 0.02


def test_a_boss_with_something_beside_it_ends_the_program(tmp_path):
    bench = Bench(tmp_path, ['boss: [0, 0, 0], radius_mm: 12', 'plane: [0, 0, -1]'])
    with pytest.raises(AssertionError, match='before it moved'):
        bench.run('O<probe_boss> CALL [24] [3] [4] [5] [300] [60]', [0, 0, 0.002])


@pytest.mark.parametrize('angle', [0, 90, 180, 270])
def test_an_edge_reads_zero(tmp_path, angle):
    way = np.round([np.cos(angle * DEG), np.sin(angle * DEG)])
    face = f'plane: [{5 * way[0]}, {5 * way[1]}, 0], normal: [{-way[0]}, {-way[1]}, 0]'
    bench = Bench(tmp_path, [face])
    end = bench.run(f'O<probe_edge> CALL [{angle}] [3] [10] [300] [60]', [0.0, 0.0, 0.0])
    letter = 'X' if angle % 180 == 0 else 'Y'
    assert abs(bench.zero(letter) - 5e-3 * way.sum()) < 5 * UM
    assert np.allclose(end, 0.0, atol=1e-9)


def test_a_surface_and_a_tool_are_measured(tmp_path):
    setup = JobSetup(tools={4: Tool(length=0.05)}, tool=4)
    bench = Bench(tmp_path, ['plane: [0, 0, -3]'], setup)
    bench.run('O<probe_surface> CALL [10] [300] [60]', [0.0, 0.0, 0.004])
    # As in a touch-off, the length of the tool in the spindle counts: a program calls it with G43.
    assert abs(bench.zero('Z') + 3e-3 + 0.05) < 5 * UM
    # Without a length the tool ends 3 mm under the zero of G54: 3 mm longer than none.
    bench.setup = replace(bench.setup, work_offsets={'G54': {'Z': 0.010}})
    bench.run('O<probe_tool> CALL [-2] [20] [300] [60]', [0.0, 0.0, 0.004])
    assert abs(bench.setup.tools[4].length - (-3e-3 - 10e-3 + 2e-3)) < 5 * UM


@pytest.mark.parametrize(('direction', 'apart'), [(90, 30), (0, 30), (270, -30), (180, 30)])
def test_the_offset_turns_along_a_face(tmp_path, direction, apart):
    turn = 2.5 * DEG
    way = np.array([np.cos(direction * DEG), np.sin(direction * DEG)])
    c, s = np.cos(turn), np.sin(turn)
    normal = -np.array([c * way[0] - s * way[1], s * way[0] + c * way[1]])
    face = f'plane: [{6 * way[0]}, {6 * way[1]}, 0], normal: [{normal[0]}, {normal[1]}, 0]'
    bench = Bench(tmp_path, [face])
    line = f'O<probe_angle> CALL [{direction}] [{apart}] [12] [300] [60]'
    bench.run(line, [0.0, 0.0, 0.0])
    assert abs(bench.setup.rotation('G54') - turn) < 0.02 * DEG
    bench.run(line, [0.0, 0.0, 0.0])  # the frame lies along the face: nothing is added
    assert abs(bench.setup.rotation('G54') - turn) < 0.02 * DEG


def test_units_and_modes_of_the_operator_stay(tmp_path):
    bench = Bench(tmp_path, ['plane: [0, 0, -3]'])
    reader = MdiReader(TRANSFORM, Settings())
    for text in ('G20 G91 G95 S100', 'O<probe_surface> CALL [10] [300] [60]'):
        stream = reader.line(text, np.array([0.0, 0.0, 0.004]), JobSetup())
        list(stream)
        while stream.probe is not None:
            stream.go_on(np.array([0.0, 0.0, -0.003]), np.array([0.0, 0.0, -0.003]))
            list(stream)
        reader.keep(stream)
    assert {'G20', 'G91', 'G95'} <= set(reader.modes(JobSetup()).codes)
    assert bench.gap(np.zeros(3)) > 0.0


def test_an_unknown_cycle_is_refused():
    stream = MdiReader(TRANSFORM, Settings()).line('O<probe_cone> CALL', np.zeros(3), JobSetup())
    with pytest.raises(ProgramError, match='probe_cone is not in this file'):
        list(stream)
