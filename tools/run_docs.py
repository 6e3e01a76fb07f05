"""Do the README and the pages of docs/ line by line, in a bare environment.

`python tools/run_docs.py` copies what git tracks into an empty folder, does the README there as it
stands, its virtual environment and its installation too, and then every page in an empty folder
of its own with that environment. `--here` takes the environment of this Python in place of it,
`--long` runs also what takes minutes, and PAGEs name pages.

A block's language says what is done with it: `bash` is run, `console` is run and its output
compared, `python` is run, `yaml` and `toml` are read, `diff` adds files. What cannot be run
stands in `NOT_RUN` with the reason; options of `boxgrasp` are checked there too.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import textwrap
import threading
import uuid
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    from pip._vendor import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent
FIRST = [ROOT / "README.md", ROOT / "docs" / "install.md"]  # what they do, the others rest on
PAGES = [
    *FIRST,
    *sorted({*(ROOT / "docs").glob("*.md")} - {*FIRST}),
    *(ROOT / name for name in ("CONTRIBUTING.md", "SECURITY.md", "ros/README.md")),
]
NOTICE = "compiling kernels"  # of the first process that needs one
# What a machine may lack: a registry that answers, or the venv that Debian splits off.
LACKING = (
    *("NewConnectionError", "name resolution", "ConnectTimeout", "ProxyError"),
    "ensurepip is not",
)

# What is not run, and why. In a bare environment the README's `INSTALL` is; with --long, `LONG`.
INSTALL = r"python3 -m venv |pip install \.$"
LONG = r"boxgrasp (simulate|train|evaluate)\b|boxgrasp select .*--models models"
SERVED = (
    r"boxgrasp (label|assist|labels)\b|boxgrasp select .*--assist|boxgrasp train --labels|"
    r"curl |ssh -N |\(umask 077; "
)
NOT_RUN = {
    SERVED: "needs a page that is served, a person's labels, or a token; tests have them",
    INSTALL: "the README's own installation is there",
    r"boxgrasp (reproduce|train segmentation)\b": "takes an hour and more; tests run it small",
    LONG: "takes minutes; tests run it small",
    r"git clone ": "the address is not public yet",
    r"pip install '\.\[": "extras: the bare environment shows that the rest needs none",
    r"(docker|podman) ": "needs a container engine",
    r"(ros2|rosdep|colcon|source|cd ~/ws|/usr/bin/python3 -m pip)\b": "needs ROS 2",
    r"boxgrasp (select BAG|gripper from-urdf panda\.urdf)\b": "stands for a file of yours",
    r"(eval .*)?boxgrasp completion\b": "a line for a shell's settings",
    r"make ": "this is run by `make test`",
    r"python -m (build|twine)|git (tag|push)": "makes a release",
}
PYTHON_NOT_RUN = {"moveit.md": "needs MoveIt"}
IGNORED = ("text", "js")  # drawings; the example answer, which tests/test_docs.py compares
KNOWN = ("bash", "console", "python", "yaml", "toml", "diff", *IGNORED)

FENCE = re.compile(r"^( *)(```+|:::+) *(\S*)[^\n]*\n(.*?)^\1\2 *$", re.S | re.M)
NUMBER = r"-?\d+(?:\.\d+)?"
TOKENS = re.compile(rf"\b[0-9a-f]{{16}}\b|{NUMBER}(?: m?s\b)?|\.\.\.|\s+|.", re.S)


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes:
        place: page and line.
        language: as the fence says.
        text: what is in it.
    """

    place: str
    language: str
    text: str


@dataclass(frozen=True)
class Step:
    """One thing that a page says to do.

    Attributes:
        place: page and line of the block.
        command: for a shell.
        shown: what the page says that it prints; None where it says nothing.
        reason: why it is not run; empty where it is.
    """

    place: str
    command: str
    shown: str | None = None
    reason: str = ""


def blocks_of(page: Path) -> list[Block]:
    """The fenced blocks of a page, but for directives.

    Args:
        page: its path.

    Returns:
        In their order.
    """
    text = page.read_text("utf-8")
    found = []
    for match in FENCE.finditer(text):
        line = text.count("\n", 0, match.start()) + 1
        if not match[3].startswith("{"):
            text_in_it = textwrap.dedent(match[4])
            found.append(Block(f"{page.name}:{line}", match[3], text_in_it))
    return found


def commands_of(block: Block) -> Iterator[tuple[str, str | None]]:
    """The commands of a `bash` or `console` block, and what each is said to print."""
    if block.language == "console":
        for part in re.split(r"^\$ ", block.text, flags=re.M)[1:]:
            command, _, shown = part.partition("\n")
            yield command, shown
        return
    held = ""
    for line in block.text.splitlines():
        held += line + "\n"
        if line.endswith("\\") or not _is_closed(held):
            continue
        if shlex.split(held, comments=True):
            yield held.strip(), None
        held = ""


def _is_closed(text: str) -> bool:
    try:
        shlex.split(text, comments=True)
    except ValueError:  # a quotation goes on
        return False
    return True


def steps_of(page: Path, also: Collection[str] = ()) -> list[Step]:
    """What a page says to do.

    Args:
        page: its path.
        also: keys of `NOT_RUN` that are run all the same.

    Returns:
        In the page's order.
    """
    steps = []
    for block in blocks_of(page):
        if block.language in ("bash", "console"):
            for command, shown in commands_of(block):
                steps.append(Step(block.place, command, shown, _reason(command, also)))
        elif block.language == "python":
            code = f"python - <<'END_OF_BLOCK'\n{block.text}\nEND_OF_BLOCK"
            steps.append(Step(block.place, code, None, PYTHON_NOT_RUN.get(page.name, "")))
    return steps


def _reason(command: str, also: Collection[str]) -> str:
    for pattern, reason in NOT_RUN.items():
        if re.match(pattern, command):
            return "" if pattern in also else reason
    return ""


def faults_of(page: Path) -> list[str]:
    """What is wrong with a page without running it.

    Args:
        page: its path.

    Returns:
        A line a fault: languages that are not known, data that cannot be read, Python that is none,
        and options of commands that are not run.
    """
    faults = []
    for block in blocks_of(page):
        if block.language not in KNOWN:
            faults.append(f"{block.place}: a block of {block.language or 'no language'}")
        try:
            if block.language == "yaml":
                read_yaml(block.text)
            elif block.language == "toml":
                tomllib.loads(block.text)
            elif block.language == "python":
                compile(block.text, block.place, "exec")
        except Exception as error:
            faults.append(f"{block.place}: {error}")
    for step in steps_of(page):
        if step.reason and (said := _option_fault(step.command)):
            faults.append(f"{step.place}: {step.command}: {said}")
    return faults


def read_yaml(text: str) -> None:
    """Read a snippet as what it is: objects, a gripper, a configuration, else plain YAML.

    Args:
        text: the snippet.

    Raises:
        BoxgraspError: it would be refused.
    """
    import yaml

    from boxgrasp.config import load_config, load_gripper
    from boxgrasp.simulate import load_objects

    data = yaml.safe_load(text)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "snippet.yaml"
        path.write_text(text, "utf-8")
        if "objects" in data:
            load_objects(str(path))
        elif "length_m" in data:
            load_gripper(str(path))
        elif "plugins" not in data.get("checks", {}):  # tests/test_plugins.py installs some
            load_config(str(path))


def _option_fault(command: str) -> str | None:
    """Why the parser of `boxgrasp` would refuse a command that is not run."""
    from boxgrasp.cli import COMMANDS, command_parser

    words = shlex.split(re.split(r" [|>] ", command)[0], comments=True)
    if words[0] != "boxgrasp":
        return None
    if words[1] not in COMMANDS:
        return f"no command {words[1]}"
    try:
        command_parser(words[1]).parse_intermixed_args(words[2:])
    except SystemExit:
        return "refused"
    return None


# Running.


class Shell:
    """A bash that stays, so that `cd` and an activated environment do."""

    def __init__(self, folder: Path, programs: Path | None = None) -> None:
        """Start.

        Args:
            folder: to start in.
            programs: folder of an environment's programs; None for those of this Python's origin.
        """
        first = programs or Path(sys.base_prefix) / "bin"
        env = {
            "PATH": os.pathsep.join([str(first), "/usr/local/bin", "/usr/bin", "/bin"]),
            "HOME": str(folder),
            "LC_ALL": "C.UTF-8",
        }
        kept = ("PIP_", "OPENBLAS", "NUMBA_CACHE_DIR", "SSL_", "http", "HTTP", "no_proxy")
        env |= {name: value for name, value in os.environ.items() if name.startswith(kept)}
        if programs == Path(sys.executable).parent and "PYTHONPATH" in os.environ:
            env["PYTHONPATH"] = os.environ["PYTHONPATH"]
        self._bash = subprocess.Popen(
            ["bash", "--norc", "--noprofile"], cwd=folder, env=env, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip

    def run(self, command: str, timeout_s: float = 900.0) -> tuple[int, str]:
        """Run a command to its end.

        Args:
            command: one or more lines.
            timeout_s: after which the shell is killed.

        Returns:
            Exit status, and what was printed on both outputs.
        """
        bash, end = self._bash, uuid.uuid4().hex
        assert bash.stdin is not None and bash.stdout is not None
        watch = threading.Timer(timeout_s, bash.kill)
        watch.start()
        # The next command may ask for this one's status, too.
        bash.stdin.write(f"{command}\nstatus=$?; echo {end} $status; (exit $status)\n")
        bash.stdin.flush()
        lines: list[str] = []
        for line in bash.stdout:
            before, found, status = line.partition(end)
            if found:
                watch.cancel()
                return int(status), "".join([*lines, before])
            lines.append(line)
        watch.cancel()
        return -1, "".join(lines)

    def close(self) -> None:
        """End the shell."""
        assert self._bash.stdin is not None and self._bash.stdout is not None
        self._bash.stdin.close()
        self._bash.wait()
        self._bash.stdout.close()


def difference(shown: str, printed: str) -> str | None:
    """How an output differs from the page's: words must be equal, numbers nearly, times not.

    Args:
        shown: on the page; `...` stands for anything.
        printed: by the command.

    Returns:
        What differs, or None.
    """
    pattern, numbers = "", []
    for token in TOKENS.findall(shown.strip()):
        if re.fullmatch(rf"{NUMBER} m?s", token):
            pattern += rf"{NUMBER} m?s"
        elif re.fullmatch(NUMBER, token):
            pattern += f"({NUMBER})"
            numbers.append(token)
        elif token == "...":
            pattern += ".*?"
        else:
            pattern += r"\s+" if token.isspace() else re.escape(token)
    match = re.fullmatch(pattern, printed.strip(), re.S)
    if match is None:
        return f"other words:\n{printed}"
    for said, found in zip(numbers, match.groups(), strict=True):
        if not _is_near(said, found):
            return f"{said} is {found}:\n{printed}"
    return None


def _is_near(said: str, found: str) -> bool:
    """Within two of the last place; counts from 100 on within one in a hundred.

    Processors differ in the last bits of a float, and so does what is rounded from it.
    """
    places = len(said.partition(".")[2])
    off = abs(float(said) - float(found))
    if places:
        return off < 2.5 * 10.0**-places
    return off <= (0.01 * abs(float(said)) if abs(float(said)) >= 100 else 0)


def done(step: Step, shell: Shell, *, may_compile: bool = False) -> str | None:
    """Do one step.

    Args:
        step: that is run.
        shell: to do it in.
        may_compile: whether it may say that it compiles kernels.

    Returns:
        What is wrong with it, or None.
    """
    status, printed = shell.run(step.command)
    lines = [line for line in printed.splitlines(True) if NOTICE not in line]
    if NOTICE in printed and not may_compile:
        return "compiles kernels; `boxgrasp warm-up` was to leave none"
    if step.shown is None:
        return f"exit status {status}:\n{printed}" if status else None
    return difference(step.shown, "".join(lines))


def prepare(page: Path, folder: Path) -> None:
    """Write the files that a page's diffs add at the top of the folder.

    Args:
        page: its path.
        folder: where its commands run.
    """
    for block in blocks_of(page):
        if block.language == "diff":
            pattern = r"^\+\+\+ b/([^/\s]+)\n@@ -0,0 .*\n((?:\+.*\n)+)"
            for name, lines in re.findall(pattern, block.text, re.M):
                (folder / name).write_text(re.sub(r"^\+", "", lines, flags=re.M), "utf-8")


def run_page(
    page: Path, folder: Path, programs: Path | None, also: Collection[str] = ()
) -> Iterator[str]:
    """Do a page.

    Args:
        page: its path.
        folder: where it is done.
        programs: folder of an environment's programs; None for the system's.
        also: as `steps_of`.

    Yields:
        A line a step that fails.
    """
    prepare(page, folder)
    shell = Shell(folder, programs)
    for step in steps_of(page, also):
        head = step.command.partition("\n")[0]
        if step.reason:
            print(f"{step.place}: not run ({step.reason}): {head}", flush=True)
        elif fault := done(step, shell, may_compile=page in FIRST):
            yield f"{step.place}: {head}: {fault}"
        else:
            print(f"{step.place}: {head}", flush=True)
    shell.close()


def install(folder: Path) -> tuple[list[str], Path]:
    """Do the README in a copy of the clone, installation and all.

    Args:
        folder: that is empty.

    Returns:
        A line a step that fails, and the folder of the environment's programs.
    """
    copy_clone(folder)
    return list(run_page(FIRST[0], folder, None, (INSTALL,))), folder / ".venv" / "bin"


def copy_clone(folder: Path) -> Path:
    """What git tracks and has not thrown away, as a clone has it.

    Args:
        folder: to put it in.

    Returns:
        The copy.
    """
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    told = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, told.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def main(argv: list[str] | None = None) -> int:
    """Do all of it, and say what fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("pages", nargs="*", type=Path, metavar="PAGE", help="default: all")
    parser.add_argument("--here", action="store_true", help="the environment of this Python")
    parser.add_argument("--long", action="store_true", help="run also what takes minutes")
    args = parser.parse_args(argv)
    pages = [path.resolve() for path in args.pages] or PAGES
    faults = [fault for page in pages for fault in faults_of(page)]
    with tempfile.TemporaryDirectory() as place:
        programs = Path(sys.executable).parent
        if not args.here:
            said, programs = install(Path(place) / "clone")
            faults += said
            pages = [page for page in pages if page != FIRST[0]]
        for number, page in enumerate(pages):
            folder = Path(place) / str(number)
            folder.mkdir()
            faults += run_page(page, folder, programs, (LONG,) if args.long else ())
    print("\n".join(faults) or "all as printed")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
