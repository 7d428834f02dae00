"""Short programs whose tool axes lie on the pole, beside it by rounding, or near it."""

import numpy as np
from programs import blocks_of
from tiers import examples
from whole_plans import plan_program, write_plan

from cnc_interp.core import DEG, MM, MM_PER_MIN, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.program import Program
from cnc_interp.proof.verify import verify_plan
from cnc_interp.settings.options import Settings

COUNT = examples(8, 240)
TILTS = np.array([0.0, 0.0, 1e-7, 1e-4, 0.01, 0.5, 10.0, 30.0]) * DEG
MACHINES = [Machine.load(name) for name in ('xyzac', 'head_head', 'xyzbc_trt', 'head_table')]


def program(seed):
    """Four to eight poses with the digits of CL data, and stops."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 9))
    steps = rng.normal(size=(n, 3)) * rng.choice([0.01, 1.0, 10.0], n)[:, None]
    steps[rng.random(n) < 0.2] = 0.0
    tilt, heading = rng.choice(TILTS, n), rng.uniform(0.0, 2.0 * np.pi, n)
    axis = np.c_[np.sin(tilt) * np.cos(heading), np.sin(tilt) * np.sin(heading), np.cos(tilt)]
    stop = rng.random(n) < 0.4
    stop[-1] = True
    return blocks_of(
        np.cumsum(steps, axis=0).round(9) * MM,
        axis.round(12),
        feed=float(rng.choice([500.0, 3000.0, 20000.0])) * MM_PER_MIN,
        exact_stop=stop,
    )


def test_they_are_proven_on_every_machine(tmp_path):
    faults, refused = [], 0
    for seed in range(COUNT):
        machine, period = MACHINES[seed % 4], (1e-3, 0.25e-3)[seed // 4 % 2]
        made = Program(program(seed), (), f'near the pole {seed}', 'cl')
        settings = Settings(interpolation_period=period)
        folder = tmp_path / str(seed)
        try:
            plan = plan_program(made, machine, settings)
        except InterpError:  # a turn at the pole on too short a way, or travel
            refused += 1
            continue
        write_plan(plan, folder)
        proof = verify_plan(folder, machine)
        if not proof.ok:
            faults.append(f'seed {seed} on {machine.name}: {proof.text()}')
    assert not faults, faults
    assert refused <= 0.125 * COUNT
