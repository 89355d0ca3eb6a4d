"""MkDocs hook: adds the pages that are made from code, and links into them.

Links from pages to files of the repository that are no pages (code, examples) become
text: the site stands for itself, without a server of code behind it.
"""

import json
import re
from pathlib import Path

from mkdocs.structure.files import File

from residual.effects import load_effects
from scripts.docs_site.pages import FOLDER, TABLES, generated, llms_txt
from scripts.docs_site.schemas import schemas

_ROW = re.compile(r"^\| `(\w+)` \|", re.M)


def on_config(config):
    """List every effect in the navigation, and pages that mkdocs.yml forgot."""
    listed = set(re.findall(r"[\w/]+\.md", json.dumps(config.nav)))
    folder = Path(config.docs_dir)
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*.md")}
    if more := sorted(there - listed):
        config.nav.append({"More": more})
    pages = [{name: f"{FOLDER}/{name}.md"} for name in load_effects()]
    config.nav.append({"Every effect": pages})
    return config


def on_files(files, config):
    """Add the generated pages before navigation is made."""
    made = {
        **generated(),
        **{place: json.dumps(schema, indent=1) for place, schema in schemas().items()},
        "llms.txt": llms_txt(config.nav, Path(config.docs_dir)),
    }
    for place, text in made.items():
        files.append(File.generated(config, place, content=text))
    return files


def on_post_build(config):
    """Give the theme the index that it asks for where pages are opened from the disk.

    It is empty: a browser starts no search of a page from the disk, and without the
    file it would complain. The home says how to serve the pages.
    """
    empty = {"config": {"lang": ["en"], "separator": " "}, "docs": []}
    place = Path(config.site_dir, "search", "search_index.js")
    place.write_text(f"var __index = {json.dumps(empty)};\n", encoding="utf-8")


def on_page_markdown(markdown, page, config, files):
    """Fill in generated tables, link effects to their pages, unlink what is no page."""
    source = page.file.src_uri
    for name, table in TABLES.items():
        markdown = markdown.replace(f"<!-- generated: {name} -->", table())
    if source == "effects.md":
        markdown = _ROW.sub(_linked, markdown)
    if source.startswith(f"{FOLDER}/"):
        return markdown
    return _outside(markdown, source.count("/"))


def _linked(row: re.Match) -> str:
    name = row[1]
    return f"| [`{name}`]({FOLDER}/{name}.md) |" if name in load_effects() else row[0]


def _outside(markdown: str, depth: int) -> str:
    """Replace links that lead out of docs/ by the words that they have."""
    up = "../" * (depth + 1)
    link = re.compile(rf"\[([^\]]+)\]\({re.escape(up)}[^)]*\)")
    return link.sub(r"\1", markdown)
