"""A page as tests read it: its tags, text, scripts and the data of its figures."""

import json
from html.parser import HTMLParser


class Page(HTMLParser):
    """Collects tags, attributes, text, scripts and data of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.words: list[str] = []
        self.open: list[str] = []
        self.scripts: list[str] = []
        self.plots: list[dict] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br", "input", "link"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        inside = self.open[-1] if self.open else ""
        if inside != "script":
            self.words.append(data)
        elif self.all("script")[-1]:
            self.plots.append(json.loads(data))
        else:
            self.scripts.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    @property
    def figures(self) -> list[str]:
        """What each figure shows, in words."""
        drawn = [tag.get("aria-label") for tag in self.all("div") if "role" in tag]
        return [*drawn, *(image["alt"] for image in self.all("img"))]

    def all(self, tag: str) -> list[dict]:
        return [attrs for name, attrs in self.tags if name == tag]
