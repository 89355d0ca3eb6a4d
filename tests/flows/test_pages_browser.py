"""The pages in a real browser, wide and narrow: seen whole, read by all, alone."""

import pytest

from flows.report.charts import render_diagnosis_page
from tests.flows import report_outcomes as outcomes
from tests.flows.browser import alone

pytestmark = pytest.mark.long

PAGES = {
    "several": lambda: render_diagnosis_page(outcomes.several(), "kr300"),
    "nothing": lambda: render_diagnosis_page(outcomes.nothing(), "kr300"),
}
WIDTHS = (1280, 768, 390)
# Draws what is drawn when it comes into sight, and opens what is folded.
UNFOLD = """
for (const fold of document.querySelectorAll("details")) fold.open = true;
dispatchEvent(new Event("beforeprint"));
dispatchEvent(new Event("afterprint"));
true"""
DRAWN = """[...document.querySelectorAll(".plot")].every(
  (box) => box._fullLayout && box.querySelector(".main-svg"))"""
# As DRAWN, of what is not folded.
SHOWN = """[...document.querySelectorAll(".plot")].filter(
  (box) => !box.closest("details:not([open])")).every(
  (box) => box._fullLayout && box.querySelector(".main-svg"))"""
# Where what is folded begins [px].
FOLDS = "document.getElementById('sizes').getBoundingClientRect().top + scrollY"
# What reaches beyond the window, other than within what scrolls by itself.
CLIPPED = """[...document.querySelectorAll("body *")].filter((one) =>
  one.getBoundingClientRect().right > innerWidth + 1
  && !one.closest(".scroll, .wide, svg")).map((one) => one.outerHTML)"""
# WCAG 2.2, 1.4.3: contrast of text and its ground, by their relative luminances.
PALE = """(() => {
  const rgb = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = ([r, g, b]) => [r, g, b].map((c) => c / 255)
    .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4))
    .reduce((sum, c, i) => sum + c * [0.2126, 0.7152, 0.0722][i], 0);
  const ground = (one) => {
    for (let at = one; at; at = at.parentElement) {
      const colour = rgb(getComputedStyle(at).backgroundColor);
      if (colour.length < 4 || colour[3] > 0) return colour;
    }
    return [255, 255, 255];
  };
  const faint = [];
  for (const one of document.querySelectorAll("body *")) {
    const own = [...one.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
    const drawn = one instanceof SVGElement;
    if (!own || one.closest("script, style, noscript") || !one.getClientRects().length)
      continue;
    const style = getComputedStyle(one);
    const [a, b] = [rgb(drawn ? style.fill : style.color), ground(one)].map(light);
    const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    const large = parseFloat(style.fontSize) >= 24;
    if (contrast < (large ? 3 : 4.5)) faint.push([one.textContent, contrast]);
  }
  return faint;
})()"""
# How light the page is, 0 to 255; a figure is never lighter or darker.
GROUND = """((of) => of.every((c) => c === of[0]) ? Number(of[0].match(/\\d+/)) : NaN)(
  [...document.querySelectorAll("body, .main-svg:first-child")].map(
    (one) => getComputedStyle(one).backgroundColor))"""
# What Tab must reach, and how what has the focus shows it.
CONTROLS = """[...document.querySelectorAll(
  "a[href], summary, select, input, button")].filter((one) =>
  one.checkVisibility()).length"""
FOCUS = """((one) => one === document.body ? null : [
  [...document.querySelectorAll("*")].indexOf(one), one.matches(
    "a[href], summary, select, input, button"),
  getComputedStyle(one).outlineStyle === "solid"
    && parseFloat(getComputedStyle(one).outlineWidth) >= 2])(document.activeElement)"""
# Buttons of a figure have names of their own; with the tester the library measures text
# that nobody sees.
WORDLESS = """[...document.querySelectorAll(
  "img, .plot, canvas, svg:not(.modebar svg, #js-plotly-tester)")].filter((one) =>
  (one.alt ?? one.closest("[aria-label]")?.ariaLabel ?? "").length < 30)
  .map((one) => one.outerHTML.slice(0, 90))"""


@pytest.fixture
def tab(tmp_path):
    with alone(tmp_path / "browser", "") as tab:
        yield tab


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_whole_readable_and_alone(tab, tmp_path, name):
    page = tmp_path / "page.html"
    page.write_text(PAGES[name](), encoding="utf-8")
    for width in WIDTHS:
        tab.resize(width, 900)
        tab.open(page.as_uri())
        ready = "location.protocol === 'file:' && document.readyState === 'complete'"
        tab.wait(ready, f"{name} is open")
        if width == WIDTHS[0]:
            tab.wait(SHOWN, "all figures are drawn without scrolling")
            assert tab.run("scrollY") == 0
            assert tab.run(FOLDS) <= 4000
        tab.run(UNFOLD)
        tab.wait(DRAWN, f"all figures of {name} are drawn")
        assert tab.run("document.body.scrollWidth <= innerWidth"), (name, width)
        assert tab.run(CLIPPED) == [], (name, width)
        for scheme, shade in (("dark", "< 64"), ("light", "> 192")):
            tab.prefer(scheme)
            tab.wait(f"{GROUND} {shade}", f"{name} is {scheme}")
            assert tab.run(PALE) == [], (name, width, scheme)
        assert tab.run(WORDLESS) == [], (name, width)
    assert tab.said == tab.refused == []
    assert set(tab.asked.values()) == {page.as_uri()}
    tab.run("document.querySelector('h1').style.color = '#999'")
    assert len(tab.run(PALE)) == 1  # so it sees what is faint


def test_tab_reaches_every_control_of_a_page_and_shows_where_it_is(tab, tmp_path):
    page = tmp_path / "page.html"
    page.write_text(PAGES["several"](), encoding="utf-8")
    tab.open(page.as_uri())
    ready = "location.protocol === 'file:' && document.readyState === 'complete'"
    tab.wait(f"{ready} && {SHOWN}", "all figures are drawn")
    count, seen = tab.run(CONTROLS), {}
    assert count > 10
    for _ in range(3 * count):
        tab.press_tab()
        if (focus := tab.run(FOCUS)) is None or focus[0] in seen:
            break
        seen[focus[0]] = focus[1:]
    assert sum(control for control, _ in seen.values()) == count
    assert all(outlined for _, outlined in seen.values())
