"""The entry point ``fourd``: runs a command and reports an error as one line and an exit code."""

from __future__ import annotations

import errno
import os
import select
import signal
import sys
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor
from pathlib import Path

from fourd.base.errors import UserError, command_line
from fourd.base.limits import printable
from fourd.base.processes import ReceivedSignals, handle_termination
from fourd.base.processes.torchrun import rank_count

COMMANDS = {
    "make": "runs.make",
    "calibrate": "captures.calibrate",
    "import": "captures.import_",
    "synth": "captures.synth",
    "check": "captures.check",
    "matte": "captures.matte",
    "carve": "captures.carve",
    "mesh": "captures.mesh",
    "fit-triangles": "captures.fit_triangles",
    "train": "runs.train",
    "eval": "runs.eval",
    "export": "runs.export",
    "pack": "scenes.pack",
    "edit": "scenes.edit",
    "render": "rendering.render",
    "view": "scenes.view",
    "web": "scenes.web",
    "serve": "scenes.serve",
    "bench": "scenes.bench",
    "info": "scenes.info",
    "verify": "scenes.verify",
}
"""The module of each command, relative to :mod:`fourd.cli`."""

TORCH_COMMANDS = ("make", "mesh", "train", "eval", "export", "bench")
"""The commands that import torch whatever their arguments are."""

FILE_ERRORS = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EEXIST,
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.ENOTDIR,
    errno.EISDIR,
    errno.ENAMETOOLONG,
    errno.ELOOP,
    errno.EIO,
    errno.EMFILE,
    errno.ENFILE,
    errno.EBUSY,
    errno.ENXIO,
    errno.ENOTEMPTY,
    errno.ESTALE,
)
"""File system errors that the user can fix."""

SYSTEM_FOLDERS = ("/proc", "/sys")
"""Folders in which no program can create files. If a program tries, Linux reports that the file does not exist."""

MAX_MESSAGE = 4000
"""Maximum length of an error message in characters. If a message is longer, for example because it quotes a file, its
middle is left out."""
MAX_SHOWN = 200
"""If the name of a file or camera is not valid UTF-8, the error message quotes at most this number of characters of the
name."""

LESS_MEMORY = "use smaller images or fewer points, or a machine with more memory"

VIDEO_PACKAGE = "av"
"""The import name of the package PyAV. Some commands import PyAV only when they run."""
TRAINING_PACKAGES = ("h5py", "pycolmap", "safetensors", "tensorboard", "torch", "xatlas")
"""Python packages of the extra ``fourd[train]``. Playing a scene does not need these packages."""
VIEWER_PACKAGES = ("glfw", "imgui_bundle")
"""Import names of the packages of the extra ``fourd[viewer]``. Only windows need these packages."""
WITHOUT_WINDOW = "pip install 'fourd[viewer]', or add --headless FILE.mp4 or --screenshot FILE.png"

HELP = """fourd turns multi-view video of a moving scene into a 4D point scene.

  fourd make VIDEOS|CAPTURE -o scene.4dv
                                    run every stage from videos to a scene; cached and resumable
  fourd calibrate VIDEOS --board BOARD.toml -o CALIBRATION
                                    calibrate a rig from videos of a moving board
  fourd import [FORMAT] SRC OUT     import another program's calibration and videos
  fourd synth OUT                   make a synthetic capture with ground truth
  fourd check CAPTURE               list a capture's contents and problems
  fourd matte CAPTURE               make mattes and clean plates
  fourd carve CAPTURE               carve initial points of each frame from mattes
  fourd mesh CAPTURE|RUN -o DIR     make one textured mesh for each frame
  fourd fit-triangles CAPTURE -o FILE
                                    fit a mesh to one frame by triangle splatting
  fourd train CAPTURE --out RUN     train a model
  fourd eval RUN                    evaluate a run on held-out views
  fourd export RUN -o scene.4dv     bake a scene for real-time rendering
  fourd pack SCENE -o scene.4dv     convert a scene to a compact file
  fourd edit SCENE -o scene.4dv     cut, crop, move, recolour or combine scenes
  fourd render RUN|SCENE --out OUT  render images or a video
  fourd view SCENE|RUN              play a scene in a window
  fourd web SCENE -o DIR            write a web page that plays a scene
  fourd serve SCENE|RUN             show a scene in the web browser
  fourd bench                       time kernels and stages on this machine
  fourd info FILE|DIR               describe a file or folder
  fourd verify RUN|SCENE|CAPTURE    verify that files are whole and unaltered

fourd COMMAND --help, or fourd help COMMAND, lists the command's options and their units. For commands with many
options, it lists those that are used most, and fourd COMMAND --help-all lists all of them.
Exit codes: 0 success; 1 internal error; 2 wrong input, or a file that cannot be read or written;
130 interrupted by Ctrl-C or SIGTERM (finished results are kept);
141 the program that reads the output ended first.
"""


HELP_ALL = "--help-all"
"""The option that lists all options of a command."""

BROKEN_PIPE = 141
"""Exit code if the program that reads the output ends before fourd, as in ``fourd info FILE | head``.

Shells report the same exit code for a process that is ended by the signal SIGPIPE.
"""

SPIN_COUNT = "1000"
"""Value of GOMP_SPINCOUNT: the number of iterations that an idle OpenMP thread of torch spins before it sleeps.

With OpenMP's default value, spinning threads delay fourd's own threads on the same cores. On two busy cores, a training
step of fox_run takes 9% less CPU time with 1,000 iterations than with 20,000, which take 6 to 12% less time than the
default.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        try:
            with ReceivedSignals() as signals:
                return _report_interrupts(words, signals)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        if not _reader_is_gone():
            raise
        return BROKEN_PIPE


def console_main() -> int:
    """Run the command that the user typed in the terminal, and return the exit code. The process must exit afterwards,
    because it ignores Ctrl-C from then on."""
    # torchrun ends its processes (ranks) with SIGTERM. A rank that waits for other ranks could not run a Python
    # handler, so ranks keep the default action.
    if rank_count() == 1:
        handle_termination()
    try:
        return main()
    finally:
        # Ctrl-C is ignored after the command has ended, because it would only print a traceback while Python exits.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _reader_is_gone() -> bool:
    """Return whether the program that reads the standard output has ended. If it has, discard all further output."""
    try:
        output = sys.stdout.fileno()
    except OSError:
        return False
    if hasattr(select, "poll"):
        poll = select.poll()
        poll.register(output, 0)
        if not any(event & select.POLLERR for _, event in poll.poll(0)):
            return False
    # When Python exits, it flushes the output a second time, which would fail again. The output is therefore redirected
    # to the null device.
    os.dup2(os.open(os.devnull, os.O_WRONLY), output)
    return True


def _report_interrupts(words: list[str], signals: ReceivedSignals) -> int:
    """Run a command, and report Ctrl-C as one line. An unexpected error after Ctrl-C is the interrupt that C++ code has
    turned into an error of its own."""
    try:
        return _report_errors(words)
    except KeyboardInterrupt:
        pass
    except Exception:
        if not signals.any():
            raise
    from fourd.base.progress import Terminal

    Terminal(stderr=True).print(f"fourd {words[0]}: interrupted; finished results are kept")
    return 130


def _report_errors(words: list[str]) -> int:
    """Run a command, and report an error as one line."""
    # GOMP_SPINCOUNT is set before a command imports torch, because GNU OpenMP reads the variable during this import.
    os.environ.setdefault("GOMP_SPINCOUNT", SPIN_COUNT)
    if words[:1] == ["help"]:
        words = [*words[1:2], "--help"]
    if not words or words[0] in ("-h", "--help", "--help-all"):
        print(HELP, end="")
        return 0
    if words[0] in ("-V", "--version"):
        from fourd.base.version import __version__

        print(f"fourd {__version__}")
        return 0
    try:
        return _run(words[0], words[1:])
    except UserError as error:
        return _fail(words[0], str(error))
    except ModuleNotFoundError as error:
        package = (error.name or "").split(".")[0]
        if package == VIDEO_PACKAGE:
            return _fail(words[0], f"expected the package {package}, got none; install it: pip install {package}")
        if package in VIEWER_PACKAGES:
            return _fail(words[0], f"expected the packages for windows, but {package} is missing; {WITHOUT_WINDOW}")
        if package not in TRAINING_PACKAGES:
            raise
        missing = f"expected the training packages, but {package} is missing; pip install 'fourd[train]'"
        return _fail(words[0], missing)
    except MemoryError as error:
        asked = f" ({error})" if str(error) else ""
        return _fail(words[0], f"expected input that fits in memory, got larger input{asked}; {LESS_MEMORY}")
    except RecursionError:
        return _fail(words[0], "expected files of moderate depth, got deeply nested content; restore the files")
    except UnicodeEncodeError as error:
        # Python reads paths that are not UTF-8 as text with lone surrogates, which cannot be encoded.
        got = f"got {printable(str(error.object))[:MAX_SHOWN]}"
        return _fail(words[0], f"expected names of files and cameras in UTF-8, {got}; rename the file or the folder")
    except BrokenExecutor:
        got = "got one that the system ended, usually because of missing memory"
        return _fail(words[0], f"expected worker processes that finish, {got}; use fewer --workers, or {LESS_MEMORY}")
    except OSError as error:
        if error.errno not in FILE_ERRORS and not _is_in_system_folder(error):
            raise
        reason = (error.strerror or "").lower()
        got = f"expected a readable and writable path, got '{reason}'; free disk space or use another folder"
        return _fail(words[0], f"{error.filename or 'the disk'}: {got}")


def _is_in_system_folder(error: OSError) -> bool:
    """Return True if the error is a FileNotFoundError for a path in one of :data:`SYSTEM_FOLDERS`."""
    if not isinstance(error, FileNotFoundError) or not isinstance(error.filename, str):
        return False
    path = Path(os.path.realpath(error.filename))
    return any(path.is_relative_to(folder) for folder in SYSTEM_FOLDERS)


def _fail(command: str, message: str) -> int:
    """Print an error as one line and return the exit code 2."""
    text = printable(message)
    text = text if len(text) <= MAX_MESSAGE else f"{text[: MAX_MESSAGE // 2]} ... {text[-MAX_MESSAGE // 2 :]}"
    print(f"fourd {printable(command)}: {text}", file=sys.stderr)
    return 2


def _run(command: str, words: list[str]) -> int:
    """Import and run one command. Other commands are not imported, so that ``fourd info`` does not load torch."""
    import difflib
    import importlib

    import tyro

    from fourd.cli.help import help_form, rare_options
    from fourd.cli.loading import load_package
    from fourd.cli.locations import refuse_urls
    from fourd.cli.outputs import refuse_overwriting
    from fourd.cli.usage import one_line_of_usage

    if command not in COMMANDS:
        near = difflib.get_close_matches(command, COMMANDS, n=1)
        hint = f"did you mean '{near[0]}'?" if near else "see fourd --help"
        raise UserError(f"expected a command among {', '.join(COMMANDS)}, got '{command}'; {hint}")
    module = importlib.import_module(f"fourd.cli.{COMMANDS[command]}")
    if signal.getsignal(signal.SIGTERM) is signal.default_int_handler:
        handle_termination()  # The import of a C++ library such as pycolmap may have replaced the handler.
    form, description = module.Arguments, f"{module.__doc__} {module.Arguments.__doc__}"
    if any(word in ("-h", "--help", HELP_ALL) for word in words):
        is_short = HELP_ALL not in words
        left_out = len(list(rare_options(form))) if is_short else 0
        if left_out:
            description += f" {command_line('fourd', command, HELP_ALL)} lists {left_out} more options."
        form, words = help_form(form, is_short=is_short), ["--help"]
    with one_line_of_usage():
        arguments = tyro.cli(
            form,
            prog=f"fourd {command}",
            args=words,
            description=_wrap(description),
            config=(tyro.conf.OmitArgPrefixes,),
        )
    refuse_urls(arguments, words)
    refuse_overwriting(arguments)
    if command in TORCH_COMMANDS and rank_count() == 1:
        load_package("torch")
    code = module.run(arguments)
    return 0 if code is None else int(code)


def _wrap(text: str) -> str:
    """Wrap a description to the width of the terminal. Every wrapped line starts with a space, because tyro joins lines
    that do not start with a space."""
    import shutil
    import textwrap

    width = max(40, shutil.get_terminal_size().columns)
    return textwrap.fill(" ".join(text.split()), width, initial_indent=" ", subsequent_indent=" ")


if __name__ == "__main__":
    sys.exit(console_main())
