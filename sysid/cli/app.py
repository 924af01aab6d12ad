"""``sysid``: the command group, and the translation of errors to exit statuses."""

from __future__ import annotations

import importlib
import io
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

import click

from sysid.children import safe_children
from sysid.errors import StorageError, SysidError, nearest, storage_error
from sysid.extras import extra_of, install_remedy
from sysid.foreign import visible
from sysid.release import __version__


@dataclass(frozen=True)
class Verb:
    """Location of a verb's command, and its line in ``sysid --help``."""

    location: str
    help: str


#: In the order of work. ``location`` is ``module:command``.
VERBS: dict[str, Verb] = {
    "start": Verb("sysid.cli.start:start", "From a folder of logs to a verdict."),
    "init": Verb("sysid.cli.init:init", "Create the folders and templates for a machine."),
    "ingest": Verb("sysid.cli.ingest:ingest", "Turn raw logs into a new dataset version."),
    "datasets": Verb("sysid.cli.datasets:datasets", "List dataset versions, or show one."),
    "fit": Verb("sysid.cli.fit:fit", "Fit the actuator, motion or forward networks of a dataset."),
    "validate": Verb("sysid.cli.validate:validate", "Evaluate a fitted network on held-out recordings."),
    "models": Verb("sysid.cli.models:models", "List model versions, show, promote, compare or export one."),
    "gap": Verb("sysid.cli.gap:gap", "Name the effects that the simulation lacks."),
    "fleet": Verb("sysid.cli.fleet:fleet", "Compare many machines of one type, and watch them for drift."),
    "export": Verb("sysid.cli.export:export", "Write a plant for another simulator, with its replay."),
    "train": Verb("sysid.cli.train:train", "Train a policy on a fitted plant."),
    "track": Verb("sysid.cli.track:track", "Follow a path with a policy, or with inverse kinematics."),
    "run": Verb("sysid.cli.run:run", "Run a task on a machine: supervised, recorded, stoppable."),
    "view": Verb("sysid.cli.view:view", "Write a Rerun recording of the moving machine."),
    "report": Verb("sysid.cli.report:report", "Write the HTML report of a dataset."),
    "ui": Verb("sysid.cli.ui:ui", "Write the workspace as linked pages, or serve them."),
    "demo": Verb("sysid.cli.demo:demo", "Run the whole workflow on the shipped logs."),
}


class LazyGroup(click.Group):
    """A group that imports the module of a verb only when the verb is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in VERBS:
            return None
        module, _, attribute = VERBS[cmd_name].location.partition(":")
        command: click.Command = getattr(importlib.import_module(module), attribute)
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in VERBS and not args[0].startswith("-"):
            ctx.fail(f"no verb {args[0]!r}; did you mean {nearest(args[0], VERBS)}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Verbs, in the order of work"):
            formatter.write_dl([(name, verb.help) for name, verb in VERBS.items()])


@click.group(
    cls=LazyGroup,
    subcommand_metavar="VERB …",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="sysid")
@click.option(
    "--workspace",
    envvar="SYSID_WORKSPACE",
    default="./workspace",
    show_default=True,
    metavar="DIR",
    help="Folder of datasets, models and reports (or SYSID_WORKSPACE).",
)
@click.pass_context
def app(ctx: click.Context, workspace: str) -> None:
    """System identification: explains differences between the logs of a machine and its simulation.

    A dataset or model is named NAME (its newest version) or NAME@VERSION.
    """
    ctx.obj = workspace


def run_verb(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command line with child processes that are safe, and exit.

    Raises:
        KeyboardInterrupt: Ctrl-C; nothing is printed about it yet.
    """
    with safe_children():
        status = run_command(None if argv is None else list(argv))
    sys.exit(status)


def run_command(argv: list[str] | None) -> int:
    """Run one command (by default that of ``sys.argv``), print errors, and return the exit status."""
    try:
        status = app.main(args=argv, prog_name="sysid", standalone_mode=False)
        if isinstance(status, int) and status:
            return status  # set by the verb
    except SysidError as error:
        return _complain(str(error), 1 if isinstance(error, StorageError) else 2)
    except click.ClickException as error:
        shown = io.StringIO()
        error.show(shown)
        click.echo(visible(shown.getvalue(), keep="\n"), err=True, nl=False)
        return error.exit_code
    except click.Abort:  # click's name for an interrupt
        raise KeyboardInterrupt from None
    except BrokenPipeError:
        # The reader of the output has closed it (`sysid datasets | head`).
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except ModuleNotFoundError as error:
        if not error.name or not extra_of(error):
            raise  # not a package of an extra: a bug, which needs its traceback
        return _complain(f"this needs the package {error.name}, which is not installed. {install_remedy(error.name)}", 2)
    except OSError as error:
        if error.filename is None and error.errno is None:
            raise  # not about a file: a bug, which needs its traceback
        return _complain(str(storage_error(error)), 1)
    return 0


def _complain(message: str, status: int) -> int:
    click.echo(click.style("sysid: ", fg="red", bold=True) + visible(" ".join(message.split())), err=True)
    return status
