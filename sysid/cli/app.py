"""``sysid``: the command group, and the translation of errors to exit statuses."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

import click

from sysid.children import safe_children
from sysid.cli import verbs
from sysid.errors import StorageError, SysidError, nearest, storage_error
from sysid.extras import extra_of, install_remedy
from sysid.foreign import visible
from sysid.release import __version__


class LazyGroup(click.Group):
    """A group that imports the module of a verb only when the verb is called (:mod:`sysid.cli.verbs`)."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return verbs.names()

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        try:
            return verbs.command(cmd_name)
        except verbs.UNLOADED:
            if ctx.resilient_parsing:  # completion in a shell: of the verbs that load
                return None
            raise

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in verbs.VERBS and not args[0].startswith("-") and args[0] not in (known := verbs.names()):
            ctx.fail(f"no verb {args[0]!r}; did you mean {nearest(args[0], known)}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Verbs, in the order of work"):
            formatter.write_dl([(name, visible(" ".join(verb.help.split()))) for name, verb in verbs.all_verbs().items()])


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
