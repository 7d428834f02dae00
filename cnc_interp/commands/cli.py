"""The `cnc-interp` command: run the chosen command, and report a mistake in one clear line."""

import argparse
import contextlib
import errno
import signal
import sys
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path
from types import FrameType

import cnc_interp
from cnc_interp.commands import convert, identify, machine_files
from cnc_interp.commands.batch import add_batch_commands, add_sweep_command
from cnc_interp.commands.cam import add_cam_commands
from cnc_interp.commands.check import add_bag_commands, add_check_commands, add_problems_command
from cnc_interp.commands.estimate import add_estimate_command
from cnc_interp.commands.operate import add_operate_commands
from cnc_interp.commands.parser import BAD_INPUT, FINE, CommandParser, command, option
from cnc_interp.commands.plan import (
    add_mtconnect_command,
    add_panel_command,
    add_plan_command,
    add_run_command,
)
from cnc_interp.commands.send import add_send_command
from cnc_interp.core import InterpError

#: Options that name output files. Their folders are made before any work begins.
WRITTEN = 'out', 'html', 'record', 'export', 'write'


def main(arguments: Sequence[str] | None = None) -> int:
    options = None
    try:
        options = parser().parse_args(arguments)
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, interrupt)
        for name in WRITTEN:
            if isinstance(place := getattr(options, name, None), Path):
                place.parent.mkdir(parents=True, exist_ok=True)
        return int(options.command(options))
    except InterpError as problem:
        print(f'cnc-interp: {problem}', file=sys.stderr)
        return BAD_INPUT
    except OSError as problem:
        if isinstance(problem, BrokenPipeError):
            sys.stderr.close()
            return FINE
        print(f'cnc-interp: {_told(problem, options)}', file=sys.stderr)
        return BAD_INPUT
    except ModuleNotFoundError as problem:
        package = str(problem.name).partition('.')[0]
        if package == 'cnc_interp':
            raise
        told = f'{package} is not installed; ./cnc of a clone installs what each command needs'
        print(f'cnc-interp: {told}', file=sys.stderr)
        return BAD_INPUT
    except (KeyboardInterrupt, ImportError) as problem:
        if not _is_interrupt(problem):
            raise
        with contextlib.suppress(OSError):  # the terminal may be closed
            print('cnc-interp: interrupted', file=sys.stderr)
        return 130


def _is_interrupt(problem: BaseException | None) -> bool:
    """Return whether Ctrl-C was the cause; libraries that load may turn it into ImportError."""
    while not isinstance(problem, KeyboardInterrupt | None):
        problem = problem.__cause__ or problem.__context__
    return problem is not None


def _told(problem: OSError, options: argparse.Namespace | None) -> str:
    """Return the message for a file-system error; for a full disk, it names the output file."""
    place = problem.filename or getattr(options, 'out', None) or getattr(options, 'record', None)
    reason = problem.strerror or str(problem)
    if isinstance(problem, FileExistsError | NotADirectoryError):
        reason = 'this is a file where a folder is needed; name another folder'
    if isinstance(problem, IsADirectoryError):
        reason = 'it is a folder; name a file'
    if problem.errno == errno.ENOSPC and not place:  # semaphores of processes have no name
        place = '/dev/shm or a temporary folder'
    return f'{place}: {reason}' if place else reason


def interrupt(_number: int, _frame: FrameType | None) -> None:
    """End as after Ctrl-C: stop the nodes and remove temporary files."""
    raise KeyboardInterrupt


class Version(argparse.Action):
    """Print version and commit: that of the build, or of the checkout."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        package = Path(cnc_interp.__file__).parent
        noted, found = package / 'commit.txt', ''
        if noted.exists():
            found = noted.read_text()
        elif (package.parent / '.git').exists():
            import subprocess

            git = ['git', 'describe', '--always', '--dirty=+', '--exclude=*']
            found = subprocess.run(git, cwd=package, capture_output=True, text=True).stdout
        print(f'cnc-interp {cnc_interp.__version__} {found.strip()}'.rstrip())
        parser.exit()


@cache
def parser() -> argparse.ArgumentParser:
    top = CommandParser(
        prog='cnc-interp',
        description='5-axis CNC interpolator: smooth, plan and run part programs, every setpoint '
        'proven.',
    )
    top.add_argument('--version', action=Version, nargs=0, help='print version and commit')
    commands = top.add_subparsers(required=True, metavar='COMMAND')

    for add in (
        add_run_command,
        add_plan_command,
        add_estimate_command,
        add_batch_commands,
        partial(add_sweep_command, main=main),
        convert.add_convert_command,
        add_check_commands,
        add_panel_command,
        add_mtconnect_command,
        add_operate_commands,
        add_send_command,
        machine_files.add_machine_commands,
        add_bag_commands,
        identify.add_identify_commands,
        add_cam_commands,
        add_problems_command,
    ):
        add(commands)
    command(
        commands,
        completion_command,
        'completion bash > ~/.local/share/bash-completion/completions/cnc-interp',
        option('kind', 'shell, or man', choices=('bash', 'zsh', 'man')),
    )
    return top


def completion_command(options: argparse.Namespace) -> int:
    """Print the completion script of a shell, or the man page."""
    if options.kind == 'man':
        from argparse_manpage.manpage import Manpage

        print(Manpage(parser()))
    else:
        import shtab

        print(shtab.complete(parser(), options.kind))
    return FINE
