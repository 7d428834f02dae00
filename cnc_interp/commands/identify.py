"""Drives and run times of a machine, measured on recorded runs."""

from argparse import Namespace
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from cnc_interp.commands.parser import FINE, command, machine_option, option
from cnc_interp.core import UM, InterpError
from cnc_interp.settings.command_line import add_settings, settings_from


def add_identify_commands(commands: Any) -> None:
    command(
        commands,
        excite_command,
        'excite --machine xyzac_tired --out out/excite.ngc',
        machine_option(),
        option('--out', 'program to write', Path, 'FILE', required=True),
    )
    command(
        commands,
        identify_command,
        'identify out/excited --out my_machine.yaml',
        option('bag', 'bag of a run of that program', Path, 'BAG'),
        option('--machine', 'another machine than the bag names', metavar='M'),
        option('--out', 'machine file to write', Path, 'FILE', required=True),
        option('--html', 'page to write (default: FILE with .html)', Path, 'FILE'),
    )
    command(
        commands,
        fit_limits_command,
        'fit-limits part_blocks.csv part.nc --machine mine.yaml --out fitted.yaml',
        option(
            'pairs',
            'CSV file time_s,block and the program that ran; further pairs may follow',
            Path,
            'TRACE PROGRAM',
            nargs='+',
        ),
        machine_option(),
        partial(add_settings, live=True),
        option('--out', 'machine file to write', Path, 'FILE', required=True),
        option('--html', 'page to write (default: FILE with .html)', Path, 'FILE'),
    )
    command(
        commands,
        learn_command,
        'learn out/bag --out out/learnt.npz',
        option('bag', 'bag of a run with --compensate, with its feedback', Path, 'BAG'),
        option(
            '--out',
            'file to write, for `run PROGRAM --compensate MODEL --learnt FILE`',
            Path,
            'FILE',
            required=True,
        ),
    )


def excite_command(options: Namespace) -> int:
    """Write the part program that shows how the drives of a machine follow."""
    from cnc_interp.drives.identification import excitation
    from cnc_interp.machine_model.machine import Machine

    options.out.write_text(excitation(Machine.load(options.machine)), encoding='utf-8')
    return FINE


def identify_command(options: Namespace) -> int:
    """Fit the model of each drive to a recorded run, and write it into a machine file."""
    from cnc_interp.client.bag import Bag
    from cnc_interp.client.recorded_feedback import recorded_feedback
    from cnc_interp.drives.identification import identify_axis, with_drives
    from cnc_interp.machine_model.machine import whole_text
    from cnc_interp.report.identified import identified_lines, write_identified

    with Bag(options.bag) as bag:
        if bag.parameters.get('machine_node.compensation'):
            raise InterpError(f'{options.bag}: was recorded with compensation; record one without')
        name = bag.machine(options.machine)
        run, machine = recorded_feedback(bag, name)
    found = {}
    for axis, letter in enumerate(machine.axis_names):
        print(f'fitting {letter}', flush=True)
        model = identify_axis(machine, axis, run.period, run.setpoint, run.rate, run.feedback)
        if model is not None:
            found[axis] = model
    if not found:
        raise InterpError(f'{options.bag}: no axis moved')
    for line in identified_lines(machine, found):
        print(line)
    text = with_drives(
        whole_text(name),
        machine,
        {**machine.drives, **{axis: each.drive for axis, each in found.items()}},
        {**machine.limits.loads, **{axis: each.load for axis, each in found.items() if each.load}},
        {axis: each.half_width for axis, each in found.items()},
        options.bag.name,
    )
    return _write(options, text, partial(write_identified, machine, found, run.period))


def _write(options: Namespace, text: str, write_page: Callable[[Path], None]) -> int:
    from cnc_interp.machine_model.machine import Machine

    options.out.write_text(text, encoding='utf-8')
    Machine.load(options.out)
    page = options.html or options.out.with_suffix('.html')
    write_page(page)
    print(f'machine file   {options.out}')
    print(f'page           {page}')
    return FINE


def fit_limits_command(options: Namespace) -> int:
    """Fit limits and times of a machine file to recorded runs, so that plans predict run times."""
    from cnc_interp.machine_model.machine import Machine, content_of
    from cnc_interp.report.identified import fitted_text, time_rows, value_text, write_fitted
    from cnc_interp.run.time_fit import TimedProgram, TimeFit, TracedRun, measured_override
    from cnc_interp.run.time_records import cycle_times, load_traces

    if len(options.pairs) % 2:
        raise InterpError('each TRACE needs its PROGRAM after it')
    machine, settings = Machine.load(options.machine), settings_from(options)
    programs: dict[tuple[Path, float], TimedProgram] = {}
    runs: list[TracedRun] = []
    for file, path in zip(options.pairs[::2], options.pairs[1::2], strict=True):
        if (path, 1.0) not in programs:
            programs[path, 1.0] = TimedProgram.load(path, machine, settings)
        plain, before = programs[path, 1.0], len(runs)
        if times := cycle_times(file):
            mine = [one for one in times if one.program == path.name]
            if not mine:
                raise InterpError(f'{file}: no row has the program {path.name}')
            runs += TracedRun.of_times(plain, machine, mine, file)
            print(f'{file.name}: {len(mine)} times of {path.name}')
            continue
        short = ''
        for trace in load_traces(file, path):
            override = measured_override(plain, trace)
            program = programs.setdefault((path, override), plain.overridden(override))
            try:
                runs.append(TracedRun.of(program, trace))
            except InterpError as problem:  # one of several runs may be short
                short = str(problem)
                continue
            print(f'{file.name}: {len(runs[-1].windows)} windows, feed override {override:.1%}')
        if len(runs) == before:
            raise InterpError(short)
    found = TimeFit(machine, runs, lambda text: print(text, flush=True)).solve()
    for key, pair in found.values.items():
        print(f'  {key:50s} {value_text(*pair)}')
    for row in time_rows(runs, found):
        print('{}, lines {}: measured {} s, planned {} s, {}'.format(*row))
    text = fitted_text(content_of(options.machine), found, [run.trace.name for run in runs])
    return _write(options, text, partial(write_fitted, runs, found))


def learn_command(options: Namespace) -> int:
    """Learn from a recorded, compensated run how to follow the same program better."""
    from cnc_interp.client.bag import Bag
    from cnc_interp.client.recorded_feedback import recorded_lesson

    with Bag(options.bag) as bag:
        lesson = recorded_lesson(bag)
    lesson.motion.save(options.out)
    print('run   tip, largest   tip, mean')
    for number, (largest, mean) in enumerate(lesson.motion.error / UM, 1):
        print(f'{number:3d}   {largest:9.1f} um   {mean:6.2f} um')
    print(f'runs learnt    {len(lesson.motion.error)}')
    print(f'written        {options.out}')
    return FINE
