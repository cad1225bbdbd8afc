"""Hooks of mkdocs: pages from files outside of docs/, the gallery, and a check of the reference.

Links are written as they lead in the repository, and are turned to where they lead in the site.
"""

from __future__ import annotations

import ast
import logging
import posixpath
import re
import textwrap
import zlib
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
PAGES = {
    "index.md": "README.md",
    "contributing.md": "CONTRIBUTING.md",
    "changelog.md": "CHANGELOG.md",
    "benchmarks.md": "benchmarks/README.md",
}
FILES = {"LICENSE.txt": "LICENSE", "CITATION.cff": "CITATION.cff"}
PACKAGES = ("contact_system", "drake_plant", "fmu_export")
LOG = logging.getLogger("mkdocs.hooks.pages")  # what it warns of fails a strict build


def on_files(files, config):
    """Add the pages that lie elsewhere, and the gallery."""
    for page, source in (PAGES | FILES).items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / source)))
    files.append(File.generated(config, "gallery.md", content=_gallery()))
    return files


def _gallery() -> str:
    """A card for each example, and below its text, its picture and its program."""
    cards, sections = [], []
    for path in sorted((ROOT / "examples").glob("*.py"), key=lambda p: (p.stat().st_size, p.name)):
        code = path.read_text("utf-8")
        title, text = ast.get_docstring(ast.parse(code)).split("\n\n", 1)
        picture = f"![{title}](gallery/{path.stem}.png)"
        program = textwrap.indent(f"```python\n{code}```", "    ")
        cards.append(f"-   [{picture}](#{path.stem})\n\n    {title}\n\n")
        sections.append(
            f'## {title} {{ #{path.stem} }}\n\n{text}\n\n{picture}\n\n??? "examples/{path.name}"\n'
            f"\n{program}\n"
        )
    grid = f'<div class="grid cards" markdown>\n\n{"".join(cards)}\n</div>'
    opening = "Each example is one program, the shortest first; a picture leads to it."
    return "\n\n".join(["# Gallery", opening, grid, *sections])


def on_page_markdown(markdown, page, config, files):
    """Turn a page's links."""
    here = page.file.src_uri
    source = ROOT / PAGES.get(here, f"docs/{here}")
    there = {ROOT / source: uri for uri, source in (PAGES | FILES).items()}
    there |= {ROOT / "docs" / file.src_uri: file.src_uri for file in files}

    def led(link: re.Match) -> str:
        target, hash_, section = link[1].partition("#")
        path = (source.parent / target).resolve()
        if path == ROOT / "examples":
            target = "gallery.md"
        elif path.parent == ROOT / "examples":
            target, hash_, section = "gallery.md", "#", path.stem
        elif target and path in there:
            target = there[path]
        else:
            return link[0]
        return f"]({posixpath.relpath(target, posixpath.dirname(here) or '.')}{hash_}{section})"

    return re.sub(r"\]\(([^):\s]+)\)", led, markdown)


def on_page_content(html, page, config, files):
    """Leave out the roles and directives of Sphinx in docstrings; let pictures show their files."""
    html = re.sub(r":(func|attr|meth|class|mod):(?=<code>)|<p>\.\. pydrake_system::</p>", "", html)
    return re.sub(r'(?<=<p>)(<img [^>]*src="([^"]+)"[^>]*>)(?=</p>)', r'<a href="\2">\1</a>', html)


def on_post_build(config):
    """Warn of public names that no page of the reference has."""
    inventory = (Path(config.site_dir) / "objects.inv").read_bytes().split(b"\n", 4)[4]
    told = set(re.findall(r"^(\S+)", zlib.decompress(inventory).decode(), re.M))
    for package in PACKAGES:
        for name in _public(package):
            # a function may have the name of its module
            if not {f"{package}.{name}", f"{package}.{name}.{name}"} & told:
                LOG.warning("%s.%s is on no page of docs/reference", package, name)


def _public(package: str) -> list[str]:
    """A package's ``__all__``, without importing it."""
    for node in ast.parse((ROOT / package / "__init__.py").read_text("utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return ast.literal_eval(node.value)
    raise ValueError(f"{package} has no __all__")
