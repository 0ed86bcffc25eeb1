"""Run the code of the pages, and write or compare what stands below it.

    python tools/docs.py                        # compare all pages
    python tools/docs.py docs/quickstart.md     # compare one page
    python tools/docs.py --write [PAGE ...]     # write outputs and pictures

A page is plain Markdown. Its blocks of code run from top to bottom, each page in one process that
begins in an empty folder:

- ```python: what it prints stands in the ```text block below it, each figure that it leaves open
  in a picture below that, `![what is seen](_static/pages/NAME.svg)`. A picture that has the name
  of a file which the block wrote shows that file.
- ```console with outputs: below each `$ kempe ...` stands what the command prints. A list of
  commands without outputs is not run.
- a block of another kind whose first line is a comment with the name of a file, `# arm.toml`, is
  written to that file (of a .csv the lines after it).

Python that does not run, since it needs a cluster or an hour, stands in a ```py block. Numbers are
compared to 1e-5; spaces, ends of lines, and how many steps, starts, points or samples it took are
not. The pictures of docs/gallery are not compared: docs/gallery_page.py draws them.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import textwrap
import traceback
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PICTURES = DOCS / "_static" / "pages"
GALLERY = DOCS / "gallery"
"""Pages of models, which docs/gallery_page.py writes with their pictures."""
LARGEST = 60_000
"""Bytes of a picture."""
WIDTH = 100
"""Columns of the terminal in which commands print."""
WRAP = 110
"""Columns after which lines of an output are wrapped."""
SKIPPED = 3
"""Exit code of a page that needs a package which is not installed."""

BLOCK = re.compile(
    r"^```(?P<kind>[^\n`]*)\n(?P<text>.*?)^```\n"
    r"(?P<below>(?:\n*^```text\n.*?^```\n)?(?:\n*^!\[[^\n]*\]\([^\s)]*_static/pages/[^\s)]+\)\n)*)",
    re.DOTALL | re.MULTILINE,
)
SHOWN = re.compile(r"^```text\n(.*?)^```\n", re.DOTALL | re.MULTILINE)
PICTURE = re.compile(r"^!\[([^\n]*)\]\(([^\s)]+)\)\n", re.MULTILINE)
COMMAND = re.compile(r"^\$ (.*(?:\\\n.*)*)\n((?:(?!\$ ).*\n)*)", re.MULTILINE)
FILE = re.compile(r"(?:#|//|<!--) (\w[\w.-]*\.\w+)(?: -->)?\n")
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
VARIES = re.compile(
    r"\b\d+(?= (?:steps?|starts?|points?|samples?|evaluations?)\b)|(?<=\"(?:starts|points)\": )\d+"
    r"|(?<=\"iterations\": )\d+"
)
"""Counts that depend on the last digit of a processor."""


class Block(NamedTuple):
    """A fenced block: what follows its backticks, its text, the output and the pictures below it."""

    kind: str
    text: str
    line: int
    shown: str
    pictures: tuple[tuple[str, str], ...]

    @property
    def runs(self) -> bool:
        """Whether something of the block is run."""
        return self.kind == "python" or bool(self.commands)

    @property
    def commands(self) -> list[tuple[str, str]]:
        """Commands of a block of a console that has outputs, each with its output."""
        found = COMMAND.findall(self.text) if self.kind == "console" else []
        if not any(shown for _, shown in found):
            return []
        return [(c, shown) for c, shown in found if c.startswith("kempe ")]


class Outcome(NamedTuple):
    """What came of a block: its printed text, that of each command, and files of its pictures."""

    printed: str
    commands: list[str]
    pictures: list[str]


def make_block(match: re.Match[str]) -> Block:
    """Make a block of a match of `BLOCK`; only Python has an output below it."""
    below = match["below"] if match["kind"].strip() == "python" else ""
    shown = SHOWN.search(below)
    return Block(
        match["kind"].strip(),
        match["text"],
        match.string.count("\n", 0, match.start("text")) + 1,
        shown[1] if shown else "",
        tuple(PICTURE.findall(SHOWN.sub("", below))),
    )


def find_blocks(page: str) -> Iterator[tuple[re.Match[str], Block, int]]:
    """Yield the blocks of a page: their match, they themselves, and where their text ends."""
    at = 0
    while match := BLOCK.search(page, at):
        block = make_block(match)
        at = match.end() if block.kind == "python" else match.start("below")
        yield match, block, at


def read_blocks(path: Path) -> list[Block]:
    """Read the blocks of a page."""
    return [block for _, block, _ in find_blocks(path.read_text(encoding="utf-8"))]


def list_pages() -> list[Path]:
    """List the pages whose code runs; docs/gallery_page.py runs that of the pages of models."""
    every = [ROOT / "README.md", *DOCS.glob("*.md"), *DOCS.glob("add/*.md")]
    return sorted(p for p in every if any(b.runs for b in read_blocks(p)))


# ---- in a process of the page


def run_blocks(blocks: Iterable[Block], path: Path) -> Iterator[Outcome]:
    """Run the blocks of a page in the current folder, in one namespace."""
    from matplotlib import pyplot
    from typer.testing import CliRunner

    from kempe.cli import app

    pyplot.rcParams |= {"svg.hashsalt": "kempe", "figure.max_open_warning": 0}
    names: dict[str, Any] = {"__name__": "__main__"}
    for number, block in enumerate(blocks):
        printed = io.StringIO()
        commands: list[str] = []
        pictures: list[str] = []
        if named := FILE.match(block.text):
            text = block.text[named.end() :] if named[1].endswith(".csv") else block.text
            Path(named[1]).write_text(text, encoding="utf-8")
        elif block.kind == "python":
            code = compile("\n" * (block.line - 1) + block.text, str(path), "exec")
            with contextlib.redirect_stdout(printed):
                exec(code, names)
            pictures = [n for _, to in block.pictures if Path(n := Path(to).name).is_file()]
            kinds = iter([Path(to).suffix for _, to in block.pictures[len(pictures) :]])
            for k, figure in enumerate(pyplot.get_fignums()):
                stem = f"picture_{number}_{k}"
                pictures.append(save_figure(pyplot.figure(figure), stem, next(kinds, None)))
            pyplot.close("all")
        for command, _ in block.commands:
            done = CliRunner().invoke(
                app, shlex.split(command.replace("\\\n", ""), comments=True)[1:]
            )
            if done.exception and not isinstance(done.exception, SystemExit):
                raise done.exception
            commands.append(done.output)
        yield Outcome(trim_lines(printed.getvalue()), list(map(trim_lines, commands)), pictures)


def trim_lines(text: str) -> str:
    """Remove empty space at the ends of lines and of the text, and wrap long lines."""
    return "".join(
        f"{part.rstrip()}\n"
        for line in text.strip("\n").splitlines()
        for part in textwrap.wrap(line, WRAP, break_long_words=False, break_on_hyphens=False)
        or [""]
    )


def save_figure(figure: Any, stem: str, kind: str | None = None) -> str:
    """Write a figure as SVG, or as PNG where that is larger than `LARGEST`, and return the name.

    A picture of the `kind` ".svg" or ".png" stays so: sizes near `LARGEST` differ by machine.
    """
    file = Path(f"{stem}.svg")
    largest = {None: LARGEST, ".svg": 1.1 * LARGEST}.get(kind, 0)
    figure.savefig(file, bbox_inches="tight", pad_inches=0.05, metadata={"Date": None})
    text = re.sub(
        r'\b(d|x|y|points)="[^"]*"',
        lambda m: re.sub(r"(\.\d\d)\d+", r"\1", m[0]),
        file.read_text(encoding="utf-8"),
    )
    file.write_text(re.sub(r" +$", "", text, flags=re.MULTILINE), encoding="utf-8")
    dpi = 100
    while file.stat().st_size > largest:
        largest = LARGEST
        file = file.with_suffix(".png")
        figure.savefig(
            file, bbox_inches="tight", pad_inches=0.05, dpi=dpi, metadata={"Software": None}
        )
        reduce_colours(file)
        dpi -= 10
    return file.name


def reduce_colours(file: Path) -> None:
    """Write a PNG with a palette."""
    from PIL import Image

    picture = Image.open(file).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    picture.save(file, optimize=True)


def run_here(path: Path, result: Path) -> int:
    """Run a page in this process and write what came of it to a file."""
    from kempe.errors import MissingExtraError

    try:
        outcomes = list(run_blocks(read_blocks(path), path))
    except MissingExtraError as error:
        print(error.package, file=sys.stderr)
        return SKIPPED
    except ModuleNotFoundError as error:
        if not error.name or error.name.split(".")[0] == "kempe":
            raise
        print(error.name, file=sys.stderr)
        return SKIPPED
    result.write_text(json.dumps(outcomes), encoding="utf-8")
    return 0


# ---- compare and write


class SkippedPageError(Exception):
    """A page needs a package that is not installed; its text is the name of the package."""


def run_page(path: Path, folder: Path) -> list[Outcome]:
    """Run a page in a process and a folder of its own."""
    work = folder / "work"
    work.mkdir()
    command = [sys.executable, __file__, "--run", str(path.resolve()), str(folder / "result.json")]
    settings = {
        "MPLBACKEND": "Agg",
        "KEMPE_QUIET": "1",
        "NO_COLOR": "1",
        "COLUMNS": str(WIDTH),
        "TERM": "dumb",
        # signs of null vectors are those of one kind of processor
        "OPENBLAS_CORETYPE": "Haswell",
    }
    done = subprocess.run(
        command, cwd=work, env=os.environ | settings, stderr=subprocess.PIPE, text=True
    )
    if done.returncode == SKIPPED:
        raise SkippedPageError(done.stderr.split()[-1])
    if done.returncode:
        raise RuntimeError(f"{path}: {done.stderr[-3000:]}")
    found = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    return [Outcome(*row) for row in found]


def same_output(got: str, shown: str, tolerance: float = 1e-5) -> bool:
    """Return whether two outputs have the same words, and numbers that agree; `...` stands for a
    part of a word.
    """
    words = VARIES.sub("~", got).split()
    wanted = VARIES.sub("~", shown).split()
    return len(words) == len(wanted) and all(
        _same_word(a, b, tolerance) for a, b in zip(words, wanted, strict=True)
    )


def _same_word(got: str, shown: str, tolerance: float) -> bool:
    """Return whether two words are the same but for their numbers, and these agree."""
    if got == shown:
        return True
    if "..." in shown:
        return re.fullmatch(".+".join(map(re.escape, shown.split("..."))), got) is not None
    numbers = ([float(x) for x in NUMBER.findall(text)] for text in (got, shown))
    return NUMBER.sub("#", got) == NUMBER.sub("#", shown) and all(
        abs(a - b) <= tolerance for a, b in zip(*numbers, strict=True)
    )


def same_picture(new: Path, old: Path) -> bool:
    """Return whether two pictures show the same; other versions of matplotlib draw otherwise."""
    if not old.is_file() or new.suffix != old.suffix:
        return False
    if new.suffix == ".svg":
        a, b = (p.read_text(encoding="utf-8") for p in (new, old))
        made = [re.search(r"Matplotlib v[\d.]+", text) for text in (a, b)]
        if made[0] and made[1] and made[0][0] != made[1][0]:
            return True
        a, b = (re.sub(r"\b[a-z][0-9a-f]{10}\b", "id", text) for text in (a, b))
        return same_output(a, b, 0.5)
    if new.suffix == ".png":
        from matplotlib.image import imread

        one, other = imread(new), imread(old)
        return one.shape == other.shape and float(abs(one - other).mean()) < 0.01
    return True


def complete_page(page: str, name: str, outcomes: list[Outcome], folder: Path, here: Path) -> str:
    """Return a page with its outputs, and put its pictures in place.

    What differs by no more than the comparison allows stays as it is.
    """
    parts: list[str] = []
    taken = set(re.findall(r"_static/pages/([\w.-]+)", page))
    at = 0
    for (match, block, end), outcome in zip(find_blocks(page), outcomes, strict=True):
        parts.append(page[at : match.start()])
        at = end
        if block.kind == "python":
            parts.append(f"```{match['kind']}\n{block.text}```\n")
            printed = block.shown if same_output(outcome.printed, block.shown) else outcome.printed
            if printed:
                parts.append(f"\n```text\n{printed}```\n")
            for k, file in enumerate(outcome.pictures):
                new = folder / "work" / file
                if k < len(block.pictures):
                    alt, link = block.pictures[k]
                    to = Path(link).name
                else:
                    heading = re.findall(r"^#+ (.*)$", page[: match.start()], re.MULTILINE)
                    alt = heading[-1] if heading else name
                    number = next(
                        n
                        for n in range(1, 1000)
                        if f"{name}_{n}" not in {Path(t).stem for t in taken}
                    )
                    to = f"{name}_{number}{new.suffix}"
                to = str(Path(to).with_suffix(new.suffix))
                taken.add(to)
                if not same_picture(new, PICTURES / to):
                    PICTURES.mkdir(exist_ok=True)
                    shutil.copy(new, PICTURES / to)
                link = os.path.relpath(PICTURES / to, here)
                parts.append(f"\n![{alt}]({link})\n")
        else:
            text = block.text
            for (command, shown), out in zip(block.commands, outcome.commands, strict=True):
                if not same_output(out, shown):
                    text = text.replace(f"$ {command}\n{shown}", f"$ {command}\n{out}", 1)
            parts.append(f"```{match['kind']}\n{text}```\n")
    return "".join(parts) + page[at:]


def find_differences(path: Path) -> list[str]:
    """Run a page and list where it shows something else than what comes out."""
    found: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        blocks = read_blocks(path)
        for block, outcome in zip(blocks, run_page(path, folder), strict=True):
            at = f"{path.relative_to(ROOT)}:{block.line}: "
            if not same_output(outcome.printed, block.shown):
                found.append(f"{at}it prints\n{outcome.printed}")
            for (command, shown), out in zip(block.commands, outcome.commands, strict=True):
                if not same_output(out, shown):
                    found.append(f"{at}`{command}` prints\n{out}")
            links = [path.parent / link for _, link in block.pictures]
            news = [folder / "work" / file for file in outcome.pictures]
            if block.kind == "python" and path.parent != GALLERY and len(links) != len(news):
                drawn = f"{len(news)} picture{'s' if len(news) != 1 else ''}"
                found.append(f"{at}it draws {drawn}, the page shows {len(links)}")
            found += [
                f"{at}{old.name} shows something else"
                for new, old in zip(news, links, strict=False)
                if not same_picture(new, old)
            ]
    return found


def write_page(path: Path) -> bool:
    """Run a page and write its outputs and pictures; return whether the page has changed."""
    page = path.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        stem = path.stem if path.parent in (ROOT, DOCS) else f"{path.parent.name}_{path.stem}"
        new = complete_page(page, stem, run_page(path, folder), folder, path.parent)
    if new != page:
        path.write_text(new, encoding="utf-8")
    return new != page


def list_shown_pictures() -> set[str]:
    """List the names of the pictures to which pages refer."""
    pages = [ROOT / "README.md", *DOCS.glob("**/*.md")]
    return {
        name
        for page in pages
        for name in re.findall(r"_static/pages/([\w.-]+)", page.read_text(encoding="utf-8"))
    }


def main() -> int:
    """Compare or write the pages that are named, or all of them."""
    if sys.argv[1:2] == ["--run"]:
        try:
            return run_here(Path(sys.argv[2]), Path(sys.argv[3]))
        except BaseException:  # noqa: BLE001  (whatever the code of a page raises)
            traceback.print_exc()
            return 1
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path)
    parser.add_argument("--write", action="store_true", help="write outputs and pictures")
    parser.add_argument("-j", type=int, default=2, help="pages at a time")
    given = parser.parse_args()
    failed = 0

    def do(path: Path) -> str:
        try:
            if given.write and path.parent == GALLERY:
                return (
                    f"FAILED {path.name}: `python docs/gallery_page.py` writes the pages of models"
                )
            if given.write:
                return f"{path.name}: {'written' if write_page(path) else 'up to date'}"
            return "\n".join(find_differences(path))
        except SkippedPageError as error:
            return f"{path.name} is left out: {error} is not installed"
        except RuntimeError as error:
            return f"FAILED {error}"

    with ThreadPoolExecutor(given.j) as pool:
        for said in pool.map(do, [p.resolve() for p in given.pages] or list_pages()):
            if said:
                print(said, flush=True)
            failed += bool(said) and (not given.write or said.startswith("FAILED"))
    if given.write and not given.pages:
        for file in PICTURES.glob("*"):
            if file.name not in list_shown_pictures():
                file.unlink()
    return min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
