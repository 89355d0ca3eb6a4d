"""The colours of a page, light and dark, stand out on its paper (WCAG 2.1, AA)."""

import re
from pathlib import Path

import pytest

STYLE = Path("flows/report/templates/style.css")
AA = 4.5  # contrast of text, WCAG 2.1, success criterion 1.4.3


def schemes():
    """The variables of each scheme, by its name."""
    text = (Path(__file__).parents[2] / STYLE).read_text(encoding="utf-8")
    out = {}
    for block in re.findall(r":root \{(.*?)\}", text, re.S):
        rules = dict(re.findall(r"([\w-]+): ([^;]+);", block))
        out[rules["color-scheme"]] = rules
    return out


def luminance(colour):
    digits = colour.lstrip("#")
    digits = "".join(2 * d for d in digits) if len(digits) == 3 else digits
    parts = [int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)]
    light = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * light[0] + 0.7152 * light[1] + 0.0722 * light[2]


def contrast(first, second):
    low, high = sorted((luminance(first), luminance(second)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("paper", ["--paper", "--pale"])
def test_every_colour_of_text_stands_out(scheme, paper):
    rules = schemes()[scheme]
    papers = {"--paper", "--pale", "--line"}
    names = [k for k in rules if re.match(r"--(?!of-)", k) and k not in papers]
    texts = {k: rules[k] for k in names}
    assert len(texts) > 5
    low = {k: contrast(v, rules[paper]) for k, v in texts.items()}
    assert {k: round(v, 2) for k, v in low.items() if v < AA} == {}
