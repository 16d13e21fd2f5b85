"""The `hallway` command: a table of verbs, each a module that is imported when it is asked for.

A verb module has a docstring, its help, `add_arguments(parser)` and `run(args) -> int`;
what is heavy is imported inside `run`. Expected errors become one line and an exit code; a bug keeps its
traceback.
"""

import ast
import importlib.util
import os
import sys
from collections.abc import Sequence
from importlib import import_module, metadata

from runtime.cli.parsing import Parser
from runtime.errors import exit_code_of

VERBS = (
    "up",
    "map",
    "localize",
    "layer",
    "view",
    "teleop",
    "record",
    "replay",
    "info",
    "convert",
    "status",
    "topic",
    "logs",
    "doctor",
    "evaluate",
    "config",
    "keys",
    "paper",
    "completion",
)

EXIT_CODES = (
    "exit codes: 0 good, 1 failed, 2 usage or configuration, 3 device not found, 4 data lost, "
    "5 position lost, 130 after Ctrl-C with everything saved"
)

WRONG_PATHS = (FileNotFoundError, IsADirectoryError, NotADirectoryError, PermissionError)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb; return its exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    asked = next((word for word in arguments if not word.startswith("-")), None)
    parser = Parser(
        prog="hallway",
        description="Maps from one laser range finder and nothing else. To begin: hallway up demo",
        epilog=EXIT_CODES,
    )
    parser.add_argument("--version", action="version", version=f"hallway {_version()}")
    verbs = parser.add_subparsers(title="verbs", dest="verb", metavar="VERB", required=True)
    for verb in VERBS:
        if (text := about(verb)) is None:
            continue
        sub = verbs.add_parser(verb, help=text.splitlines()[0], description=text, epilog=EXIT_CODES)
        if verb == asked:
            import_module(f"runtime.cli.{verb}").add_arguments(sub)
    if not arguments:
        parser.print_help(sys.stderr)
        return 2
    args, unknown = parser.parse_known_args(arguments)
    if unknown:
        # Said by the verb's own parser, under the line that shows what the verb takes.
        verbs.choices[args.verb].refuse(unknown)
    try:
        return int(import_module(f"runtime.cli.{args.verb}").run(args))
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of our output has gone; keep the interpreter from complaining about it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        code = exit_code_of(error)
        if code is None and isinstance(error, WRONG_PATHS):
            code = 2
        elif code is None and isinstance(error, OSError):
            code = 1
        if code is None:
            raise
        print(f"hallway {args.verb}: {_one_line(error)}", file=sys.stderr)
        return code


def _one_line(error: BaseException) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


def about(verb: str) -> str | None:
    """Return what a verb's docstring says, read without importing it; None where there is no such module.

    Its first line is what the list of verbs has, one line of a terminal.
    """
    spec = importlib.util.find_spec(f"runtime.cli.{verb}")
    if spec is None or spec.origin is None:
        return None
    with open(spec.origin, encoding="utf-8") as file:
        return ast.get_docstring(ast.parse(file.read())) or verb


def _version() -> str:
    try:
        return metadata.version("hallway")
    except metadata.PackageNotFoundError:
        return "(checkout)"
