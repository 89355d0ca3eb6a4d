"""What `modelgap explain` says, and every word of the program that it explains.

Texts are Markdown, so that the terminal and the site of the documents show the same.
Effects explain themselves (`residual/effects/`).
"""

import sys
from difflib import get_close_matches
from inspect import getdoc

from flows.report.words.phrases import sentence_case, texts
from residual.effects import registry
from residual.effects.base import Effect
from residual.errors import UnknownNameError, listed, shown

# Plain texts: their marks are those of Markdown.
VERDICTS, TERMS = (
    {word: str(text) for word, text in texts()[part].items()}
    for part in ("verdicts", "terms")
)


def entries() -> dict[str, str]:
    """Every word with its explanation, verdicts first."""
    return {**VERDICTS, **TERMS}


_WHERE = {
    "local": "one joint; its torque is on that joint alone",
    "pair": "two neighbouring joints that share gearing",
    "link": "one joint, and through the arm on the torque of all others",
    "flange": "the flange, reported at the last joint",
    "global": "the whole arm; reported without a joint",
}


def explain(word: str) -> str:
    """Return the explanation of one word, as Markdown.

    Args:
        word: An effect's name, or a word of the glossary, however it is spaced.

    Raises:
        UnknownNameError: If there is none; the message has the nearest.
    """
    effects, words = registry(), entries()
    wanted = _key(word)
    names = {_key(name): name for name in (*words, *effects)}
    names |= {_key(each.noun): name for name, each in effects.items() if each.noun}
    if wanted not in names:
        near = get_close_matches(wanted, names, n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(map(repr, near))}? " if near else ""
        raise UnknownNameError(
            f"Nothing is known of {shown(word)}: {hint}"
            "modelgap explain lists all words."
        )
    name = names[wanted]
    if name in effects:
        return effect_page(effects[name])
    return f"# {name}\n\n{words[name]}\n"


def overview() -> str:
    """Return all words that can be explained, one line each, as Markdown."""
    effects = [f"- **{each.name}**: {each.sentence}" for each in registry().values()]
    # Of each its first sentence.
    first = {
        name: text.removeprefix("The verdict: ").split(". ")[0].split(": these")[0]
        for name, text in VERDICTS.items()
    }
    verdicts = [f"- **{name}**: {text}." for name, text in first.items()]
    return "\n".join(
        [
            "## Effects that a model may lack\n",
            *effects,
            "\n## Words of a verdict\n",
            *verdicts,
            "\n## Other words\n",
            f"{listed(TERMS)}.",
        ]
    )


def effect_page(effect: Effect) -> str:
    """Return the page of one effect, from its own file and nothing else."""
    units = "\n".join(f"- `{key}` [{unit}]" for key, unit in effect.parameters.items())
    # The text at the top of the file that the effect stands in.
    about = getdoc(sys.modules[f"residual.effects.{effect.name}"]) or effect.sentence
    wrong = texts()["effects"]["wrong_value"] if effect.is_parameter else ""
    parts = [
        f"# {sentence_case(effect.noun or effect.name.replace('_', ' '))}",
        f"`{effect.name}`: {effect.sentence}.",
        f"## Equation\n\n{equation(effect)}",
        f"## Parameters\n\n{units}",
        f"It acts on {_WHERE[effect.scope]}.{wrong}",
        f"## What it is\n\n{about}",
        *_confused(effect),
        *(
            [f"Where held-out motion refutes it: {effect.if_refuted}"]
            if effect.if_refuted
            else []
        ),
    ]
    return "\n\n".join(parts) + "\n"


def equation(effect: Effect) -> str:
    """Return its law as a block of Markdown, one line per part."""
    return "\n".join(f"    {line.strip()}" for line in effect.law.split(";"))


def _confused(effect: Effect) -> list[str]:
    """Members of its family: small motion does not tell them apart."""
    if not effect.family:
        return []
    names = [
        f"`{other.name}`"
        for other in registry().values()
        if other.family == effect.family and other.name != effect.name
    ]
    return [
        f"## Easily confused with\n\n{listed(names)}. On one joint only one of them is "
        "named, and motion that is too small does not tell which."
    ]


def _key(word: str) -> str:
    small = " ".join(word.lower().replace("_", " ").replace("-", " ").split())
    for article in ("a ", "an ", "the "):
        small = small.removeprefix(article)
    return small
