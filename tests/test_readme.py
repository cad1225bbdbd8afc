"""What the README shows must run as it is printed."""

from __future__ import annotations

import doctest
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import contact_system as cs

README = Path(__file__).parent.parent / "README.md"
DOCS = [f"docs/{path.name}" for path in (README.parent / "docs").glob("*.md")]


def blocks(language: str, page: Path = README) -> list[str]:
    """The fenced blocks of one language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)


def run(example: str, folder: Path | None = None) -> str:
    """What an example prints."""
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


def test_the_python_example_prints_what_the_readme_shows():
    assert run(blocks("python")[0]) == blocks("text")[0]


def test_the_drake_example_holds_about_one_newton():
    pytest.importorskip("pydrake")
    forces = np.fromstring(run(blocks("python")[1]).strip().strip("[]"), sep=" ")
    assert forces == pytest.approx([1.0, 1.0, 1.0], abs=0.15)


@pytest.mark.parametrize(("page", "package"), [("drake", "pydrake"), ("fmu", "pythonfmu")])
def test_the_examples_of_a_page_run(page, package, tmp_path):
    pytest.importorskip(package)
    examples = blocks("python", README.parent / "docs" / f"{page}.md")
    said = [run(example, tmp_path) for example in examples]
    if page == "fmu":
        (off,) = re.findall(r"^(.*) m/s$", said[-1], re.M)
        assert float(off) < 1e-15 and (tmp_path / "slip.png").exists()


def test_the_python_example_has_ten_lines():
    example = blocks("python")[0]
    assert len(example.splitlines()) == 10


@pytest.mark.parametrize("surface", [cs.ParametricSurface, cs.ImplicitSurface])
def test_examples_of_surfaces_print_what_their_help_shows(surface):
    failed, tried = doctest.testmod(sys.modules[surface.__module__])
    assert tried and not failed


def test_the_scene_file_is_read(tmp_path):
    (text,) = blocks("toml")
    (tmp_path / "mine.toml").write_text(text)
    scene = cs.load_scene(tmp_path / "mine.toml")
    assert (scene.name, len(scene.contacts), len(scene.disturbances)) == ("mine", 1, 1)


def test_every_bundled_scene_is_listed():
    pages = [README.parent / page for page in ("README.md", *DOCS)]
    lines = "\n".join(page.read_text("utf-8") for page in pages).splitlines()
    table = "\n".join(line for line in lines if line[:1] == "|")
    missing = [name for name in cs.bundled_scenes() if not re.search(rf"\b{name}\b", table)]
    assert not missing


def test_the_examples_of_the_page_on_fmus_run(tmp_path):
    pytest.importorskip("fmpy")
    for example in blocks("python", README.parent / "docs" / "fmu.md"):
        run(example, tmp_path)


def test_sections_of_the_theory_that_the_code_cites_are_there():
    root = README.parent
    there = set(re.findall(r"^## (\d+) ", (root / "docs" / "theory.md").read_text("utf-8"), re.M))
    cited = set()
    for folder in ("contact_system", "fmu_export", "drake_plant", "benchmarks", "tests"):
        for path in (root / folder).rglob("*.py"):
            for numbers in re.findall(r"theory sections? ([\d, to]+)", path.read_text("utf-8")):
                cited |= set(re.findall(r"\d+", numbers))
    assert cited and cited <= there


@pytest.mark.parametrize("page", sorted(["README.md", *DOCS]))
def test_links_lead_to_files_that_are_there(page):
    path = README.parent / page
    links = re.findall(r"\]\(([^)#:]+)\)", path.read_text("utf-8"))
    assert [link for link in links if not (path.parent / link).exists()] == []


PACKAGES = ["contact_system", "drake_plant", "fmu_export"]


def test_a_source_distribution_holds_what_the_layout_shows():
    manifest = (README.parent / "MANIFEST.in").read_text("utf-8")
    held = {*PACKAGES, *re.findall(r"^graft ([.\w]+)", manifest, re.M)}
    assert sorted(held) == sorted(re.findall(r"^([.\w]+)/", blocks("text")[-1], re.M))


@pytest.mark.parametrize("package", PACKAGES)
def test_type_checkers_are_told_that_there_are_types(package):
    assert (README.parent / package / "py.typed").exists()
