"""Every word of the program is explained, and what is typed wrongly is found."""

import re

import pytest

from flows.cli import main
from flows.report.words.explain import TERMS, VERDICTS, explain
from residual.effects import registry
from residual.errors import UnknownNameError


@pytest.mark.parametrize("name", sorted(registry()))
def test_an_effect_is_explained_by_what_its_file_says(name):
    effect, text = registry()[name], explain(name)
    assert effect.sentence in text
    assert effect.law.split(";")[0].strip() in text
    for key, unit in effect.parameters.items():
        assert f"`{key}` [{unit}]" in text


def test_a_word_is_found_however_it_is_written():
    assert explain("a spring") == explain("Spring") == explain("spring")
    assert explain("minimum_detectable") == explain("Minimum  detectable")
    assert VERDICTS["unknown"] in explain("unknown")


def test_a_misspelt_word_gets_the_nearest_in_one_line():
    with pytest.raises(UnknownNameError, match="did you mean 'stribeck'") as caught:
        explain("stribek")
    assert "modelgap explain lists all words" in str(caught.value)
    assert len(str(caught.value)) < 200


def test_no_word_of_the_glossary_hides_an_effect_and_each_ends_as_a_sentence():
    assert not {*VERDICTS, *TERMS} & set(registry())
    assert not set(VERDICTS) & set(TERMS)
    assert list(TERMS) == sorted(TERMS)
    for text in (*VERDICTS.values(), *TERMS.values()):
        assert re.match(r"[A-Z0-9]", text)
        assert text[-1] in ".?"


def test_the_command_prints_the_page_and_refuses_with_exit_code_two(capsys):
    assert main(["explain", "stribeck"]) == 0
    assert "level * exp(-|qd / velocity|^exponent)" in capsys.readouterr().out
    assert main(["explain", "no", "such", "thing"]) == 2
    assert "Nothing is known of 'no such thing'" in capsys.readouterr().err
