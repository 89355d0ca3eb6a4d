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

  function draw(box) {
    if (box.dataset.drawn) return;
    box.dataset.drawn = "yes";
    const figure = JSON.parse(box.querySelector("script").textContent);
    box.textContent = "";
    const layout = { autosize: true, height: box.clientHeight, ...figure.layout };
    // A finger scrolls the page and does not zoom a figure.
    if (matchMedia("(pointer: coarse)").matches) layout.dragmode = false;
    Plotly.newPlot(box, figure.data, layout, config);
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
    const box = boxes.find((each) => !each.dataset.drawn && shown(each));
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
      Plotly.relayout(box, { autosize: false, width: PAPER });
    }
  });
  addEventListener("afterprint", () => {
    for (const fold of closed.splice(0)) fold.open = false;
    for (const box of boxes) Plotly.relayout(box, { autosize: true, width: null });
  });
})();
