"""Every command on a page is one that there is, and no code is outside of a block."""

from __future__ import annotations

import importlib.util
import re
import shlex

import pytest
from docs_cases import DOCS, PAGES, ROOT, blocks, commands, named_commands

from mitsuba_bezier.errors import BezierError

if (tomllib := importlib.util.find_spec("tomllib")) is not None:
    import tomllib
else:  # before Python 3.11
    import tomli as tomllib

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
#: Programs of others, which are not held against anything.
OTHERS = {"brew", "cd", "dask", "git", "make", "mypy", "ruff", "sbatch", "twine", "mkdocs", "."}
#: Files of the reader's own project, in the pages that speak of one.
YOURS = {"regression", "verification", "howto/regression-suite"}
#: What stands for a value in text.
FOR = {"N": "2", "I/N": "1/2", "S": "2", "GIB": "1", "CHECKOUT": ".", "K": "3", "COMMAND": "info"}


def options(words: list[str]) -> list[str]:
    """Return the names of the options among words."""
    return [word.split("=")[0] for word in words if re.match(r"--?[a-zA-Z]", word)]


def check_ours(words: list[str]) -> None:
    """Parse a command line as the program does."""
    from mitsuba_bezier.cli.main import COMMANDS, parse

    words = [FOR.get(word.strip("[]"), word) for word in words]
    if len(words) == 2 and words[1] in COMMANDS:  # a command is spoken of
        return
    if "--help" not in words:
        parse(words[1:])


def check_script(words: list[str]) -> None:
    """A script of the repository: it is there, and knows its options."""
    if words[1] == "-m":
        module = {"pytest": check_pytest, "mypy": None, "venv": None, "build": None}
        if words[2] == "mitsuba_bezier.cli.main":
            return None if len(words) == 3 else check_ours(["mitsuba-bezier", *words[3:]])
        check = module[words[2]]
        return check(words[2:]) if check else None
    if not words[1].endswith(".py"):
        assert words[1] == "-c"
        return None
    script = ROOT / words[1]
    assert script.is_file(), f"no file {words[1]}"
    # options may be added by a module beside it
    near = {path.stem: path for path in script.parent.glob("*.py")}
    text = script.read_text(encoding="utf-8")
    for name in set(re.findall(r"^\s*(?:from|import) (\w+)", text, re.M)) & set(near):
        text += near[name].read_text(encoding="utf-8")
    for option in options(words[2:]):
        assert f'"{option}"' in text, f"{words[1]} has no option {option}"


def check_pytest(words: list[str], yours: bool = False) -> None:
    """Files that are there, options of ours, tiers that are."""
    folder = ROOT / "mitsuba_bezier" / "regression"
    plugin = "".join(path.read_text(encoding="utf-8") for path in folder.glob("*.py"))
    markers = {line.split(":")[0] for line in PROJECT["tool"]["pytest"]["ini_options"]["markers"]}
    for option in options(words):
        if option.startswith("--bezier"):
            assert f'"{option}"' in plugin, f"pytest has no option {option}"
    values = iter(words[1:])
    for word in values:
        if word in ("-m", "-k", "-n"):
            value = next(values)
            assert word != "-m" or value in markers, f"no tier {value}"
        elif word.endswith(".py") or word.startswith("tests") or "/" in word:
            assert yours or (ROOT / word.split("::")[0]).exists(), f"no file {word}"


def check_pip(words: list[str]) -> None:
    """Extras that there are."""
    extras = PROJECT["project"]["optional-dependencies"]
    for word in words:
        for extra in re.findall(r"^(?:\.|mitsuba-bezier)\[([\w,]+)\]", word):
            for name in extra.split(","):
                assert name in extras, f"no extra {name}"


def check(words: list[str], page: str) -> None:
    """Hold one command against what there is."""
    words = [word for word in words if not re.match(r"[A-Z_]+=", word)]  # variables before it
    if words[0] == "mitsuba-bezier":
        check_ours(words)
    elif words[0] == "python":
        check_script(words)
    elif words[0] == "pytest":
        check_pytest(words, page in YOURS)
    elif words[0] == "pip":
        check_pip(words)
    else:
        assert words[0] in OTHERS, f"{words[0]}: what is that?"


def checked(page: str, found: list[list[str]]) -> None:
    for words in found:
        try:
            check(words, page)
        except (AssertionError, SystemExit, BezierError, KeyError) as error:
            pytest.fail(f"{page}: {shlex.join(words)}: {error}")


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_blocks(page):
    text = PAGES[page].read_text(encoding="utf-8")
    found = [words for b in blocks(text) if b.language == "sh" for words in commands(b.text)]
    checked(page, found)


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_the_text(page):
    checked(page, list(named_commands(PAGES[page].read_text(encoding="utf-8"))))


@pytest.mark.parametrize("page", PAGES)
def test_no_code_escapes_the_tests(page):
    text = PAGES[page].read_text(encoding="utf-8")
    for block in blocks(text):
        language = block.language.split()[0] if block.language else ""
        known = {"python", "sh", "xml", "toml", "yaml", "text", "{include}", "{toctree}"}
        assert language in known, f"line {block.line}: a block of {language or 'no language'}"
        if language == "text":  # what programs print, and formulas
            for line in block.text.splitlines():
                assert not re.match(r"\s*(\$ )?(mitsuba-bezier|python|pip|pytest) ", line), line
        if language == "toml":
            tomllib.loads(block.text)
        if language == "yaml":
            for line in re.findall(r"- (?:run: )?((?:pip|pytest|mitsuba-bezier) .*)", block.text):
                words = next(commands(re.sub(r"\$\{\{.*?\}\}", "2", line)))
                check(words, "regression")
    # four blanks are code, too, but for what belongs to a list: use fences with a language
    in_list = False
    bare = re.sub(r"^( *)(`{3,}).*?^\1\2 *$", "text", text, flags=re.S | re.M)
    for line in bare.split("\n"):
        if re.match(r"(\*|-|\d+\.) ", line):
            in_list = True
        elif line and not line.startswith(" "):
            in_list = False
        assert in_list or not line.startswith("    "), f"a block without fences: {line}"


@pytest.mark.parametrize("page", PAGES)
def test_links(page):
    path = PAGES[page]
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", path.read_text(encoding="utf-8")):
        made = (path.parent / target).resolve().parent == (DOCS / "generated").resolve()
        there = (path.parent / target).exists()
        assert target.startswith("https://") or made or there, target


@pytest.mark.parametrize(
    "command, fault",
    [
        ("mitsuba-bezier render scene.xml --sppp 3", "2"),
        ("mitsuba-bezier rende scene.xml", "2"),
        ("python benchmarks/none.py", "no file"),
        ("python benchmarks/speed.py --lage", "no option"),
        ("pytest tests/none.py", "no file"),
        ("pytest -m unitt", "no tier"),
        ("pytest --bezier-acept", "no option"),
        ("pip install '.[nothing]'", "no extra"),
        ("rm -rf x", "what is that"),
    ],
)
def test_a_wrong_command_is_found(command, fault):
    with pytest.raises((AssertionError, SystemExit), match=fault):
        check(shlex.split(command), "page")
