"""The generated pages of the site, as Markdown: effects, their list, the glossary."""

from flows.report.words.explain import TERMS, VERDICTS, effect_page
from residual.effects import registry
from scripts.docs_site import alike, commands, curve, found

FOLDER = "effects"


def generated() -> dict[str, str]:
    """Return every generated page by its place below docs/."""
    pages = {f"{FOLDER}/{name}.md": _effect(name) for name in registry()}
    return {**pages, "glossary.md": glossary(), "commands.md": commands.page()}


def _effect(name: str) -> str:
    effect = registry()[name]
    text = effect_page(effect).partition("\n\n## Easily confused with")[0].rstrip()
    caption = (
        "Its torque on made-up motion of the built-in arm, at a size whose largest "
        "torque is one."
    )
    drawn = (
        f'<figure class="effect">\n{curve.svg(effect)}\n'
        f"<figcaption>{caption}</figcaption>\n</figure>"
    )
    head, equation, rest = text.partition("## Equation")
    return "\n\n".join(
        [
            f"{head}{drawn}",
            f"{equation}{rest}",
            f"## What it is confused with\n\n{alike.page(name)}",
            f"## How often it is found\n\n{found.page(name)}",
            "What the rows mean, and all other figures: "
            "[what was measured](../benchmarks.md).",
            f"Its file: `residual/effects/{name}.py`.",
        ]
    )


def glossary() -> str:
    """Return the page of words; `modelgap explain` prints the same entries."""
    parts = ["# Glossary", "`modelgap explain WORD` prints each of these."]
    for title, words in (("Words of a verdict", VERDICTS), ("Other words", TERMS)):
        parts.append(f"## {title}")
        parts += [f"### {word}\n\n{text}" for word, text in words.items()]
    return "\n\n".join(parts) + "\n"
