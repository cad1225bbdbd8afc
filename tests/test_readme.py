"""Code and commands of the README and of docs run as they are printed there."""

from __future__ import annotations

import doctest
import re
import shlex
import sys
from pathlib import Path

import pytest
from conftest import ROOT, run_python

import contact_system as cs

README = ROOT / "README.md"


def blocks(language: str, page: Path = README) -> list[str]:
    """The fenced blocks of one language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)


def test_ten_lines_of_python_print_what_the_readme_shows():
    example = blocks("python")[0]
    assert len(example.splitlines()) == 10
    assert run_python("-c", example) == blocks("text")[0]


PAGES_WITH_CODE = sorted(p for p in (ROOT / "docs").glob("*.md") if blocks("python", p))
NEEDS = {"drake": "pydrake", "hands": "pydrake", "fmu": "fmpy"}
SHORTER = {  # simulations that take long, and what they are replaced by here
    "drake": ("duration=0.1", "duration=0.02"),
    "hands": ("simulate_hand(plan)", "simulate_hand(plan, duration=0.1)"),
}


@pytest.mark.parametrize("page", PAGES_WITH_CODE, ids=lambda page: page.stem)
def test_the_examples_of_a_page_of_docs_run_one_after_the_other(page, tmp_path):
    pytest.importorskip(NEEDS.get(page.stem, "contact_system"))
    program = "\n".join(blocks("python", page)).replace(*SHORTER.get(page.stem, ("", "")))
    assert run_python("-c", program, folder=tmp_path)


@pytest.mark.parametrize("surface", [cs.ParametricSurface, cs.ImplicitSurface])
def test_examples_in_the_docstrings_of_users_surfaces_print_what_they_show(surface):
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
def test_the_commands_of_a_readme_section_leave_the_file_that_it_promises(journey, tmp_path):
    needed, left = JOURNEYS[journey]
    pytest.importorskip(needed)
    mine, surface = blocks("toml")
    (tmp_path / "mine.toml").write_text(mine)
    (tmp_path / "cube.toml").write_text(re.sub(r"(?m)^object = .*\n", surface, mine))
    for line in blocks("sh")[2 + list(JOURNEYS).index(journey)].splitlines():
        program, *words = shlex.split(line)
        command = f"import sys; sys.argv[1:] = {words}; {MAIN[program]}"
        run_python("-c", command, folder=tmp_path)
    assert (tmp_path / left).stat().st_size > 0


def test_every_bundled_scene_is_in_a_table_of_the_readme_or_docs():
    pages = [README, *(ROOT / "docs").glob("*.md")]
    lines = "\n".join(page.read_text("utf-8") for page in pages).splitlines()
    table = "\n".join(line for line in lines if line[:1] == "|")
    missing = [name for name in cs.bundled_scenes() if not re.search(rf"\b{name}\b", table)]
    assert not missing


def test_the_sections_of_the_theory_that_the_code_cites_exist():
    there = set(re.findall(r"^## (\d+) ", (ROOT / "docs" / "theory.md").read_text("utf-8"), re.M))
    cited = set()
    for folder in ("contact_system", "fmu_export", "drake_plant", "benchmarks", "tests"):
        for path in (ROOT / folder).rglob("*.py"):
            for numbers in re.findall(r"theory sections? ([\d, to]+)", path.read_text("utf-8")):
                cited |= set(re.findall(r"\d+", numbers))
    assert cited and cited <= there


def test_a_source_distribution_holds_the_folders_that_the_readme_lists():
    manifest = (ROOT / "MANIFEST.in").read_text("utf-8")
    packages = {"contact_system", "drake_plant", "fmu_export"}
    held = packages | {*re.findall(r"^graft ([.\w]+)", manifest, re.M)}
    assert sorted(held) == sorted(re.findall(r"^([.\w]+)/", blocks("text")[-1], re.M))
