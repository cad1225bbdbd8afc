"""What the README shows must run as it is printed."""

from __future__ import annotations

import doctest
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import contact_system as cs

README = Path(__file__).parent.parent / "README.md"
DOCS = [f"docs/{path.name}" for path in (README.parent / "docs").glob("*.md")]


def blocks(language: str, page: Path = README) -> list[str]:
    """The fenced blocks of one language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)


def run(example: str, folder: Path | None = None) -> str:
    """Run an example; returns what it prints."""
    command = [sys.executable, "-c", example]
    paths = [str(README.parent), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        cwd=folder or README.parent,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_ten_lines_of_python_print_what_the_readme_shows():
    example = blocks("python")[0]
    assert len(example.splitlines()) == 10
    assert run(example) == blocks("text")[0]


PAGES_WITH_CODE = sorted(p for p in (README.parent / "docs").glob("*.md") if blocks("python", p))
NEEDS = {"drake": "pydrake", "hands": "pydrake", "fmu": "fmpy"}
BRIEFLY = {
    "drake": ("duration=0.1", "duration=0.02"),
    "hands": ("simulate_hand(plan)", "simulate_hand(plan, duration=0.1)"),
}


@pytest.mark.parametrize("page", PAGES_WITH_CODE, ids=lambda page: page.stem)
def test_the_examples_of_a_page_run(page, tmp_path):
    pytest.importorskip(NEEDS.get(page.stem, "contact_system"))
    assert run(
        "\n".join(blocks("python", page)).replace(*BRIEFLY.get(page.stem, ("", ""))), tmp_path
    )


@pytest.mark.parametrize("surface", [cs.ParametricSurface, cs.ImplicitSurface])
def test_examples_of_surfaces_print_what_their_help_shows(surface):
    failed, tried = doctest.testmod(sys.modules[surface.__module__])
    assert tried and not failed


MAIN = {
    "contact-system": "from contact_system.cli import main; sys.exit(main())",
    "fmpy": "from fmpy.cli import main; main()",
}
JOURNEYS = {  # the README's commands, by the packages that they need and what they leave
    "a scene of your own": ("matplotlib", "results/mine/mine.png"),
    "a surface of your own": ("matplotlib", "results/cube/mine.png"),
    "a goal": ("matplotlib", "results/mine/mine-reached.toml"),
    "Drake": ("pydrake", "results/D1/D1-drake.html"),
    "an FMU": ("fmpy", "mine.csv"),
}


@pytest.mark.parametrize("journey", JOURNEYS)
def test_the_commands_of_the_readme_write_their_results(journey, tmp_path):
    needed, left = JOURNEYS[journey]
    pytest.importorskip(needed)
    mine, surface = blocks("toml")
    (tmp_path / "mine.toml").write_text(mine)
    (tmp_path / "cube.toml").write_text(re.sub(r"(?m)^object = .*\n", surface, mine))
    for line in blocks("sh")[2 + list(JOURNEYS).index(journey)].splitlines():
        program, *words = shlex.split(line)
        run(f"import sys; sys.argv[1:] = {words}; {MAIN[program]}", tmp_path)
    assert (tmp_path / left).stat().st_size > 0


def test_every_bundled_scene_is_listed():
    pages = [README.parent / page for page in ("README.md", *DOCS)]
    lines = "\n".join(page.read_text("utf-8") for page in pages).splitlines()
    table = "\n".join(line for line in lines if line[:1] == "|")
    missing = [name for name in cs.bundled_scenes() if not re.search(rf"\b{name}\b", table)]
    assert not missing


def test_sections_of_the_theory_that_the_code_cites_are_there():
    root = README.parent
    there = set(re.findall(r"^## (\d+) ", (root / "docs" / "theory.md").read_text("utf-8"), re.M))
    cited = set()
    for folder in ("contact_system", "fmu_export", "drake_plant", "benchmarks", "tests"):
        for path in (root / folder).rglob("*.py"):
            for numbers in re.findall(r"theory sections? ([\d, to]+)", path.read_text("utf-8")):
                cited |= set(re.findall(r"\d+", numbers))
    assert cited and cited <= there


def test_a_source_distribution_holds_what_the_layout_shows():
    manifest = (README.parent / "MANIFEST.in").read_text("utf-8")
    packages = {"contact_system", "drake_plant", "fmu_export"}
    held = packages | {*re.findall(r"^graft ([.\w]+)", manifest, re.M)}
    assert sorted(held) == sorted(re.findall(r"^([.\w]+)/", blocks("text")[-1], re.M))
