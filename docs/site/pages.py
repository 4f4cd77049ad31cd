"""What the site has beside the pages of ``docs/``: README, the plugins' pages, the API, the notebook.

They stay where they are; links among them and into the code are turned into links within the site.
"""

from __future__ import annotations

import json
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
#: Rooms of the kernel, in the order in which they are read.
ROOMS = ("task", "running", "setup", "records", "command", "testing")
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
#: What an HTML element shows: its attribute and the file.
_PICTURE = re.compile(r'\b(src|srcset)="([^":]+)"')


def _module(path: Path) -> str:
    """The dotted name of a module of the kernel."""
    return ".".join(path.relative_to(ROOT / "kernel").with_suffix("").parts)


def _api() -> Iterator[tuple[str, str]]:
    """Pages of the kernel's rooms and of the wings of plugins, by their place on the site."""
    kernel = ROOT / "kernel" / "understudy"
    beside = [p for p in sorted(kernel.glob("*.py")) if p.stem not in ("__init__", "__main__")]
    for name, modules in {
        **{room: sorted((kernel / room).glob("*.py")) for room in ROOMS},
        "beside": beside,
    }.items():
        named = [_module(path) for path in modules if path.stem != "__init__"]
        body = "\n\n".join(f"::: {module}" for module in named)
        yield f"api/{name}.md", f"# `understudy.{name}`\n\n{body}\n".replace(".beside`", "`")
    for wing in sorted(page.parent for page in (ROOT / "plugins").glob("*/README.md")):
        modules = [
            path.relative_to(package.parent).with_suffix("")
            for package in sorted(wing.glob("*/understudy_*"))
            for path in sorted(package.rglob("*.py"))
            if path.stem not in ("__init__", "__main__") and "templates" not in path.parts
        ]
        body = "\n\n".join(f"::: {'.'.join(module.parts)}" for module in modules)
        yield f"api/plugins-{wing.name}.md", f"# Plugins: {wing.name}\n\n{body}\n"


def _notebook(path: Path) -> str:
    """A notebook as a page."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    shown = [
        "".join(cell["source"])
        if cell["cell_type"] == "markdown"
        else "```python\n" + "".join(cell["source"]) + "\n```"
        for cell in cells
    ]
    return "\n\n".join(shown) + "\n\n[The notebook](walk.ipynb) itself.\n"


def _sources() -> dict[str, tuple[str, str]]:
    """Generated pages: by place on the site, the file of the repository and its text."""
    found = {"index.md": ("README.md", (ROOT / "README.md").read_text(encoding="utf-8"))}
    plugins = ROOT / "plugins"
    for page in sorted(
        [*plugins.glob("README.md"), *plugins.glob("*/README.md"), *plugins.glob("*/*/README.md")]
    ):
        name = "index" if page.parent == plugins else page.parent.name
        found[f"plugins/{name}.md"] = (page.relative_to(ROOT).as_posix(), page.read_text("utf-8"))
    found["notebook/index.md"] = (
        "docs/notebook/index.md", _notebook(ROOT / "docs/notebook/walk.ipynb"),
    )  # fmt: skip
    for folder in ("decisions", "papers"):
        pages = sorted((ROOT / "docs" / folder).glob("*.md"))
        titles = [p.read_text(encoding="utf-8").splitlines()[0].lstrip("# ") for p in pages]
        rows = [f"- [{title}]({p.name})" for p, title in zip(pages, titles, strict=True)]
        text = f"# {folder.capitalize()}\n\n" + "\n".join(rows) + "\n"
        found[f"{folder}/index.md"] = (f"docs/{folder}/index.md", text)
    for place, text in _api():
        found[place] = (f"docs/{place}", text)
    return found


SOURCES = _sources()


def on_config(config: Any) -> Any:
    config.nav = [
        {"Start": ["index.md", "quick-start.md", "using.md", "how-do-i.md", "from-python.md", "gallery/index.md", "notebook/index.md", "clusters.md"]},
        {"Guides": ["tour.md", "conventions.md", "choosing.md", "ideas.md", "motion.md", "plugin-tutorial.md", "other-learners.md", "parts-and-tasks.md", "mistakes.md", "reproductions.md"]},
        {"Papers": [p for p in sorted(_places("papers"))]},
        {"Plugins": [p for p in SOURCES if p.startswith("plugins/")]},
        {"API": [p for p in SOURCES if p.startswith("api/")]},
        {"Measured": ["benchmarks/README.md", "reliability.md"]},
        {"Decisions": [p for p in sorted(_places("decisions"))]},
    ]  # fmt: skip
    return config


def _places(folder: str) -> list[str]:
    pages = [p.name for p in (ROOT / "docs" / folder).glob("*.md")]
    return [f"{folder}/index.md", *(f"{folder}/{name}" for name in sorted(pages))]


def on_files(files: Files, config: Any) -> Files:
    for place, (_, text) in SOURCES.items():
        files.append(File.generated(config, place, content=text))
    return files


#: How much a page weighs in the site's search, by what its place begins with: what a user asks comes before what
#: a developer reads, and that before cards of single tables.
_WEIGHTS = (
    ("api/", 0.05), ("decisions/", 0.3), ("benchmarks/", 0.3), ("papers/", 0.7), ("plugins/", 1.0),
    ("how-do-i.md", 8.0), ("", 2.0),
)  # fmt: skip


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Roles such as ``:meth:`` are of Sphinx' language, which this site does not speak."""
    api = page.file.src_uri.startswith("api/")
    return re.sub(r":(?:meth|class|func|mod|attr|data|obj):(?=<)", "", html) if api else html


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    place = page.file.src_uri
    weight = next(weight for begin, weight in _WEIGHTS if place.startswith(begin))
    page.meta.setdefault("search", {})["boost"] = weight
    source = SOURCES[place][0] if place in SOURCES else f"docs/{place}"

    def nearer(found: str) -> str:
        return posixpath.relpath(found.partition("#")[0], posixpath.dirname(place) or ".")

    def drawn(match: re.Match[str]) -> str:
        found = _on_site(posixpath.normpath(posixpath.join(posixpath.dirname(source), match[2])))
        return f'{match[1]}="{nearer(found)}"' if found else match.group()

    def turned(match: re.Match[str]) -> str:
        mark, text, target = match.groups()
        path, hash_, anchor = target.partition("#")
        if ":" in path or not path:
            return match.group()
        found = _on_site(posixpath.normpath(posixpath.join(posixpath.dirname(source), path)))
        if found is None:
            return text
        near = nearer(found)
        return f"{mark}[{text}]({near}{'#' if '#' in found else hash_}{found.partition('#')[2] or anchor})"

    parts = re.split(r"(^```.*?^```)", markdown, flags=re.M | re.S)
    return "".join(
        p if p.startswith("```") else _PICTURE.sub(drawn, _LINK.sub(turned, p)) for p in parts
    )


def _on_site(path: str) -> str | None:
    """Where the file or folder `path` of the repository is on the site, if it is anywhere."""
    if path == "README.md":
        return "index.md"
    if path.startswith("docs/"):
        inside = path.removeprefix("docs/")
        if not posixpath.splitext(inside)[1]:
            own = (ROOT / "docs" / inside / "README.md").is_file()
            inside = f"{inside}/{'README' if own else 'index'}.md"
        if (ROOT / "docs" / inside).is_file() and not inside.endswith(".jsonl"):
            return inside
        return inside if inside in SOURCES else None
    if path in ("plugins", "plugins/README.md"):
        return "plugins/index.md"
    folder = re.fullmatch(r"plugins/(?:\w+/)?(\w+)(/README\.md)?", path)
    if folder:
        return f"plugins/{folder[1]}.md" if f"plugins/{folder[1]}.md" in SOURCES else None
    module = re.fullmatch(r"kernel/understudy/(?:(\w+)/)?(\w+)\.py", path)
    if module and module[2] != "__init__":
        room = module[1] or "beside"
        dotted = ".".join(part for part in ("understudy", module[1], module[2]) if part)
        return f"api/{room}.md#{dotted}" if f"api/{room}.md" in SOURCES else None
    room = re.fullmatch(r"kernel/understudy/(\w+)", path)
    return f"api/{room[1]}.md" if room and f"api/{room[1]}.md" in SOURCES else None
