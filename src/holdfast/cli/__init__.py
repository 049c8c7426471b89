"""The `holdfast` command. Subcommands are imported when they are called, so that `--help` answers at once."""

import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from types import FrameType

import click

from holdfast import __version__
from holdfast.cli.given_twice import refuse_given_twice
from holdfast.cli.terminal import drop_output, guarded, shortened
from holdfast.errors import HoldfastError
from holdfast.printable import quoted

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
AGAIN_S = 0.05  # after an interrupt that was swallowed

# name -> (module, one-line help); the module has a click command of that name
COMMANDS = {
    "replay": ("holdfast.cli.replay", "Estimate the trajectory of a recording."),
    "smooth": ("holdfast.cli.smooth", "Estimate the best trajectory of a whole recording."),
    "calibrate": ("holdfast.cli.calibrate", "Find clocks, mountings and noise from recordings; write them down."),
    "live": ("holdfast.cli.live", "Estimate on a running ROS 2 machine, over DDS."),
    "view": ("holdfast.cli.view", "Show a recording or the results of a replay in Rerun."),
    "info": ("holdfast.cli.info", "List what a recording holds and what is wrong with its clocks."),
    "config": ("holdfast.cli.config", "Start, check, upgrade and describe configuration files."),
    "evaluate": ("holdfast.cli.evaluate", "Judge a trajectory against a reference."),
    "report": ("holdfast.cli.report", "Write a page about a replay that can be opened offline."),
    "export": ("holdfast.cli.export", "Write a track for surveyors: CSV, GeoJSON, KML, LAS."),
    "compare": ("holdfast.cli.compare", "Show what differs between two replays, on one page."),
    "map": ("holdfast.cli.map", "Make a map of the scans of a recording: LAZ, PLY, picture."),
    "batch": ("holdfast.cli.batch", "Replay many recordings or variations side by side."),
    "simulate": ("holdfast.cli.simulate", "Simulate a machine on a site; its truth is known."),
    "lidar-odometry": ("holdfast.cli.lidar_odometry", "Turn the point clouds of a recording into poses."),
    "demo": ("holdfast.cli.demo", "Estimate 3.7 km of real driving; needs no download."),
    "ablate": ("holdfast.cli.ablate", "Measure on a scenario what each part is worth."),
    "paper": ("holdfast.cli.paper", "Rebuild the paper's evaluation: every system, every table."),
    "bench": ("holdfast.cli.bench", "Measure speed on this machine."),
}


class LazyGroup(click.Group):
    """A click group whose commands are imported only when they run."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Refuse an empty argument, which would mean the folder in which the command runs."""
        if "" in args:
            raise click.UsageError("an argument is empty: is a variable of the shell not set?", ctx)
        return super().parse_args(ctx, args)

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the commands in the order in which a newcomer meets them."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Import the module of one command and return the command."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = getattr(import_module(COMMANDS[cmd_name][0]), cmd_name.replace("-", "_"))
        end_if_interrupted()
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, and refuse an option that is given to it twice."""
        name, command, rest = super().resolve_command(ctx, args)
        if command is not None:
            refuse_given_twice(command, ctx, rest)
        return name, command, rest

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Print the table of commands without importing any of them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="holdfast")
def holdfast() -> None:
    """Tell a construction machine where it is: IMU, RTK-GNSS and lidar odometry fused in factor graphs."""


def _one_line(message: Warning | str, *_: object, **__: object) -> str:
    """Return a warning as the user should read it: what it is, not which line of code gave it."""
    return f"warning: {shortened(str(message))}\n"


_CAUGHT: list[int] = []  # the signals that came


def end_if_interrupted() -> None:
    """Raise the `KeyboardInterrupt` that an import has swallowed, if one has: compiled modules may."""
    if _CAUGHT:
        raise KeyboardInterrupt


@contextmanager
def _interruptible() -> Iterator[list[int]]:
    """Turn Ctrl-C, the end that a service manager asks for and a closed terminal into `KeyboardInterrupt`.

    Yields the signals that came. Compiled modules make an `ImportError` of the exception: it is turned back. A callback
    from C, such as those of Numba's compiler, swallows it: it is raised again as soon as Python runs.
    """
    caught = _CAUGHT
    caught.clear()

    def note(number: int, _: FrameType | None) -> None:
        is_again = number in caught
        caught.append(number)
        if number == signal.SIGINT or not is_again:  # a closed terminal says so twice: results are being written
            raise KeyboardInterrupt

    def come_again(_: int, __: FrameType | None) -> None:
        raise KeyboardInterrupt

    def swallowed(what: "sys.UnraisableHookArgs") -> None:
        if caught and issubclass(what.exc_type, KeyboardInterrupt):
            signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
        else:
            hook(what)

    default = (signal.default_int_handler, signal.SIG_DFL)  # else: nohup, or a program of which we are a part
    before = {number: signal.getsignal(number) for number in STOPS if signal.getsignal(number) in default}
    for number in before:
        signal.signal(number, note)
    hook = sys.unraisablehook
    if before:  # where no interrupt is turned into an exception, none is swallowed
        before[signal.SIGALRM] = signal.signal(signal.SIGALRM, come_again)
        sys.unraisablehook = swallowed
    try:
        yield caught
    except Exception as error:
        if caught and not isinstance(error, click.exceptions.Exit | click.Abort):
            raise KeyboardInterrupt from error
        raise
    finally:
        if before:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


def main() -> None:
    """Run the command line; a mistake of the user ends in one line and an exit code, not in a traceback."""
    warnings.formatwarning = _one_line
    with guarded():
        _run()


def _run() -> None:
    caught: list[int] = []
    try:
        with _interruptible() as caught:
            holdfast(prog_name="holdfast", standalone_mode=False)
            sys.stdout.flush()
    except click.exceptions.Exit as error:
        sys.exit(error.exit_code)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except (click.Abort, KeyboardInterrupt) as error:
        interrupt = error.__cause__ if isinstance(error.__cause__, KeyboardInterrupt) else error
        with suppress(OSError):  # the terminal was closed
            # not by `map`: that is a module of this package once its command has been imported
            click.echo(": ".join(["interrupted", *(str(one) for one in interrupt.args)]), err=True)
        number = caught[0] if caught else signal.SIGINT
        caught.clear()  # the next command of this process was not interrupted
        sys.exit(128 + number)
    except HoldfastError as error:
        for line in str(error).split("\n"):
            click.echo(f"error: {shortened(line)}", err=True)
        sys.exit(error.exit_code)
    except MemoryError:
        click.echo("error: no memory is left on this machine for what was asked", err=True)
        sys.exit(1)
    except ImportError as error:
        reason = quoted(" ".join(str(error).split()))
        click.echo(f"error: a library cannot be loaded, for want of memory or of a file ({reason})", err=True)
        sys.exit(1)
    except BrokenPipeError:
        drop_output()
        sys.exit(0)
    except OSError as error:
        what = "the output" if error.filename is None else quoted(str(error.filename))
        drop_output()
        click.echo(f"error: {what}: cannot be written or read ({error.strerror or error})", err=True)
        sys.exit(1)
