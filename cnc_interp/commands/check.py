"""Commands that prove, report, record and replay runs, and that score feed laws."""

from __future__ import annotations

import json
import tempfile
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cnc_interp.commands.parser import FAILED, FINE, Adds, command, flag, number, option, positive
from cnc_interp.core import MS, UM, FloatArray, InterpError

if TYPE_CHECKING:
    from cnc_interp.proof.verdict import Proof


def add_check_commands(commands: Any) -> None:
    command(
        commands,
        check_command,
        'check out/pyramid',
        option('directory', 'folder with plan files, or a bag', Path, 'DIR'),
        option('--machine', 'another machine than the plan names', metavar='M'),
        option(
            '--program',
            'read the program again with a second reader, and compare it with the plan',
            Path,
            'FILE',
        ),
        flag('--json', 'print the proof as JSON'),
    )
    command(
        commands,
        report_command,
        'report out/pyramid --out out/pyramid.html',
        option('directory', 'folder with plan files, or a bag', Path, 'DIR'),
        option('--machine', 'another machine than the plan names', metavar='M'),
        option('--out --html', 'page to write (DIR/report.html)', Path, 'FILE'),
        option('--compare', 'another plan to compare with the first', Path, 'DIR2'),
    )


def check_command(options: Namespace) -> int:
    """Prove every setpoint of a plan or of all recorded runs against limits and tolerances."""
    if not is_bag(options.directory):
        proofs = [prove(options, options.directory, options.machine)]
    else:
        proofs = list(prove_runs(options))
    last = proofs[-1]
    if isinstance(last, InterpError) and len(proofs) == 1:
        raise last
    ok = all(not isinstance(proof, InterpError) and proof.ok for proof in proofs)
    if options.json:
        told = [
            {'ok': False, 'failures': [str(proof)]}
            if isinstance(proof, InterpError)
            else proof.to_json()
            for proof in proofs
        ]
        print(json.dumps(told[-1] | {'ok': ok} | ({'parts': told} if told[1:] else {}), indent=2))
        return FINE if ok else FAILED
    for k, proof in enumerate(proofs, start=1):
        if isinstance(proof, InterpError):
            print(f'run {k} of {len(proofs)}: NOT judged: {proof}')
        elif proof.ok and k < len(proofs):
            short = f'{proof.blocks} blocks, {proof.cycle_time:.3f} s, proven'
            short += f' as far as it goes: {proof.until}' * bool(proof.until)
            print(f'run {k} of {len(proofs)}: {short}')
        else:
            print((f'run {k} of {len(proofs)}:\n' if len(proofs) > 1 else '') + proof.text())
    return FINE if ok else FAILED


def prove_runs(options: Namespace) -> Iterator[Any]:
    """Yield the proof of each run of a bag, or an InterpError if a run cannot be judged."""
    from cnc_interp.client.bag import Bag
    from cnc_interp.client.recorded_run import programs_of

    with Bag(options.directory) as bag:
        programs = programs_of(bag) or [['']]
    if len(programs[-1]) > 1 and options.program is not None:
        raise InterpError(
            'a program that uses the results of its probes cannot be compared; leave out --program'
        )
    for program in programs:
        text = options.program if program is programs[-1] else None
        for run in program:
            try:
                with run_files(options.directory, options.machine, run, True) as given:
                    yield prove(Namespace(**{**vars(options), 'program': text}), *given)
            except InterpError as fault:
                yield fault


def prove(
    options: Namespace,
    folder: Path,
    named: str | None,
    beside: Sequence[FloatArray] = (),
    faults: Sequence[str] = (),
) -> Proof:
    """Prove plan files; ``faults``: contradictions in the record."""
    from cnc_interp.machine_model.machine import Machine
    from cnc_interp.proof.plan_files import read_plan
    from cnc_interp.proof.program_again import compare_with_text, with_program
    from cnc_interp.proof.verdict import given_of
    from cnc_interp.proof.verify import verify, with_beside

    plan = read_plan(folder)
    name = named or str(plan.summary.get('machine', ''))
    machine = Machine.load(name)
    given = given_of(plan, machine, name, options.directory)
    proof = replace(verify(plan, machine), given=given)
    proof = with_beside(proof, machine, plan.period, beside)
    failures = [each for each in proof.failures if each != proof.until or not plan.ends_at_rest]
    if not is_bag(options.directory):
        failures = list(proof.failures)  # only a record shows that the operator ended it
    proof = replace(proof, failures=(*failures, *faults))
    if options.program is not None:
        proof = with_program(proof, compare_with_text(plan, machine, options.program))
    return proof


def report_command(options: Namespace) -> int:
    """Write one self-contained HTML page about a plan or a recorded run."""
    from cnc_interp.machine_model.machine import Machine
    from cnc_interp.report import write_report

    options.out = page = options.out or options.directory / 'report.html'
    if is_bag(options.directory) and options.compare:
        raise InterpError('--compare compares folders of plan files, not bags')
    if is_bag(options.directory):
        with run_files(options.directory, options.machine) as (folder, name, *_):
            write_report(folder, page, Machine.load(name))
    else:
        machine = Machine.load(options.machine) if options.machine else None
        write_report(options.directory, page, machine, options.compare)
    print(f'report         {page}')
    return FINE


def is_bag(path: Path) -> bool:
    return path.suffix == '.mcap' or any(path.glob('*.mcap'))


@contextmanager
def run_files(
    path: Path, machine: str | None, run_id: str = '', compare: bool = False
) -> Iterator[tuple[Path, str, list[FloatArray], list[str]]]:
    """Yield a temporary folder with the plan files of a run in a bag: the last, or ``run_id``.

    Also yield the machine, the motion outside the program, and contradictions in the record of the
    run if they are to be checked.
    """
    from cnc_interp.client.bag import Bag
    from cnc_interp.client.executed_run import faults_of
    from cnc_interp.client.recorded_run import recorded_run, write_run
    from cnc_interp.machine_model.machine import Machine

    with Bag(path) as bag:
        run, name = recorded_run(bag, run_id), bag.machine(machine)
        faults = faults_of(bag, run, Machine.load(name)) if compare else []
    with tempfile.TemporaryDirectory(prefix='cnc_interp_') as folder:
        write_run(run, Machine.load(name), Path(folder))
        yield Path(folder), name, run.beside(Machine.load(name)), faults


def add_bag_commands(commands: Any) -> None:
    command(
        commands,
        record_command,
        'record out/shift1',
        option('bag', 'folder to create', Path, 'BAG'),
        _namespace('of the nodes'),
    )
    command(
        commands,
        replay_command,
        'replay out/shift1 --compare',
        option('bag', 'folder of the bag', Path, 'BAG'),
        flag(
            '--compare',
            'compute the setpoints from the recorded blocks; exit code 0 if bit for bit the same',
        ),
        option('--machine', 'another machine than the bag names', metavar='M'),
        option('--rate', 'speed of playback (1: as recorded)', positive, 'X', default=1.0),
        flag('--clock', 'also publish the time of the bag'),
        _namespace('to publish in'),
    )
    command(
        commands,
        repair_command,
        'repair out/shift1 --out out/shift1-repaired',
        option('bag', 'folder of the bag', Path, 'BAG'),
        option('--out', 'folder to create', Path, 'NEW', required=True),
    )


def _namespace(purpose: str) -> Adds:
    return option('--namespace', f'ROS namespace {purpose} (/)', metavar='NS', default='/')


def record_command(options: Namespace) -> int:
    """Record the messages of running nodes into a bag (rosbag2, MCAP), until Ctrl-C."""
    from cnc_interp.client.recorder import record

    count = record(options.bag, options.namespace)
    print(f'{options.bag}: {count} messages')
    return FINE


def replay_command(options: Namespace) -> int:
    """Show a recorded run again, or compute its setpoints again and compare them."""
    from cnc_interp.client.bag import Bag
    from cnc_interp.client.replay import compute_again, show_again

    with Bag(options.bag) as bag:
        if not options.compare:
            count = show_again(bag, options.namespace, options.rate, options.clock)
            print(f'{options.bag}: {count} messages of {bag.duration:.1f} s shown')
            return FINE
        same = True
        for comparison in compute_again(bag, options.machine):
            print(comparison.text())
            same = same and comparison.ok
    return FINE if same else FAILED


def repair_command(options: Namespace) -> int:
    """Write a valid bag with the messages of a bag whose recorder was killed."""
    from cnc_interp.client.bag import repair

    count, duration = repair(options.bag, options.out)
    print(f'{options.out}: {count} messages of {duration:.1f} s')
    return FINE


def add_problems_command(commands: Any) -> None:
    command(
        commands,
        problems_command,
        'problems --score out/motions',
        option('--write', 'write each path and its limits as .npz', Path, 'DIR'),
        option(
            '--score',
            'score the motions in DIR: NAME.npz with position, or NAME.csv with a row per period',
            Path,
            'DIR',
        ),
        number('--period', 1.0, 'period of the motions', 'MS'),
    )


def problems_command(options: Namespace) -> int:
    """Compare feed laws: write forty paths with optimum times, or score motions along them."""
    return (_score if options.score else _show)(options)


def _show(options: Namespace) -> int:
    import numpy as np

    from cnc_interp.problems import known, problems

    if options.write is not None:
        options.write.mkdir(parents=True, exist_ok=True)
    print(f'{"path":<28}{"optimum s":>11}{"ours s":>11}{"no jerk s":>11}')
    for case in problems():
        print(f'{case.name:<28}' + ''.join(f'{time:>11.4f}' for time in known(case.name)))
        if options.write is not None:
            names = 's', 'cell_left', 'cell_right', 'cell_feed', 'stop'
            columns = {name: getattr(case.path, name) for name in names}
            file = options.write / f'{case.name}.npz'
            np.savez_compressed(file, limits=case.limits.limits.by_order, **columns)
    return FINE


def _score(options: Namespace) -> int:
    import numpy as np

    from cnc_interp.problems import problem, score

    files = sorted([*options.score.glob('*.npz'), *options.score.glob('*.csv')])
    if not files:
        raise InterpError(f'{options.score}: has no NAME.npz or NAME.csv named after a problem')
    kept = True
    print(f'{"path":<28}{"time s":>11}{"/ optimum":>11}{"use":>9}{"beside um":>11}')
    for file in files:
        try:
            csv = file.suffix == '.csv'
            q = np.loadtxt(file, delimiter=',') if csv else np.load(file)['position']
        except (ValueError, KeyError, OSError) as fault:
            text = f'{file}: is not a motion (a position for each period): {fault}'
            raise InterpError(text) from None
        found = score(problem(file.stem), q, options.period * MS)
        kept &= found.kept
        print(
            f'{found.name:<28}{found.time:>11.4f}{found.ratio:>11.4f}{found.use:>9.2%}'
            f'{found.deviation / UM:>11.3f}' + ('' if found.kept else '  NOT kept')
        )
    return FINE if kept else FAILED
