"use strict";
// Draws each figure of the page from the data in it: visible figures first, then one by
// one all that are not folded, so that a picture of the whole page has them.
(() => {
  const PAPER = 680; // px: width of a printed figure
  const boxes = [...document.querySelectorAll(".plot")];
  const config = {
    displaylogo: false,
    responsive: true,
    scrollZoom: false,
    modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
  };

  const figures = new Map(); // the JSON of each drawn figure

  // Colours have the form that the style sheet gives them; on paper their own.
  function paint(box, paper) {
    const style = getComputedStyle(document.documentElement);
    const form = (all, hex) => style.getPropertyValue(`--of-${hex}`).trim() || all;
    const text = figures.get(box);
    const figure = JSON.parse(paper ? text : text.replace(/(?<=")#([0-9a-f]{6})(?=")/g, form));
    const size = paper ? { autosize: false, width: PAPER } : { autosize: true };
    const layout = { ...size, height: box.clientHeight, ...figure.layout };
    // A finger scrolls the page and does not zoom a figure.
    if (matchMedia("(pointer: coarse)").matches) layout.dragmode = false;
    Plotly.react(box, figure.data, layout, config);
  }

  function draw(box) {
    if (figures.has(box)) return;
    figures.set(box, box.querySelector("script").textContent);
    box.textContent = "";
    paint(box);
  }

  const observer = new IntersectionObserver(
    (entries) => {
      for (const entry of entries) {
        if (!entry.isIntersecting) continue;
        observer.unobserve(entry.target);
        draw(entry.target);
      }
    },
    { rootMargin: "400px" },
  );
  for (const box of boxes) observer.observe(box);
  const next = () => {
    const folded = "details:not([open])";
    const shown = (each) => each.clientWidth > 0 && !each.closest(folded);
    const box = boxes.find((each) => !figures.has(each) && shown(each));
    if (!box) return;
    draw(box);
    setTimeout(next);
  };
  addEventListener("load", () => setTimeout(next));

  // On paper everything is drawn and unfolded.
  const closed = [];
  addEventListener("beforeprint", () => {
    for (const fold of document.querySelectorAll("details:not([open])")) {
      closed.push(fold);
      fold.open = true;
    }
    for (const box of boxes) {
      draw(box);
      paint(box, true);
    }
  });
  addEventListener("afterprint", () => {
    for (const fold of closed.splice(0)) fold.open = false;
    for (const box of figures.keys()) paint(box);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    for (const box of figures.keys()) paint(box);
  });
})();
