// Draws one figure after the other, so that the page can be read meanwhile; `data-drawn` on <html> counts them.
(function () {
  "use strict";
  const root = document.documentElement;
  const boxes = Array.from(document.querySelectorAll(".plot"));
  const touch = window.matchMedia("(pointer: coarse)").matches;
  const paper_width_px = (box) => (box.closest(".row") ? 320 : 680); // A4 within the margins of the style sheet
  const settings = { responsive: true, displayModeBar: false }; // drag zooms, a double click shows all again
  root.dataset.drawn = "0";
  root.dataset.errors = "";
  window.addEventListener("error", (event) => { root.dataset.errors += event.message + "\n"; });
  document.addEventListener("securitypolicyviolation", (event) => {
    root.dataset.errors += event.violatedDirective + " " + event.blockedURI + "\n";
  });
  window.addEventListener("unhandledrejection", (event) => { root.dataset.errors += event.reason + "\n"; });

  function draw(index) {
    if (index === boxes.length) return;
    const box = boxes[index];
    const figure = JSON.parse(document.getElementById(box.dataset.figure).textContent);
    if (touch) figure.layout.dragmode = false; // a finger scrolls the page
    Plotly.newPlot(box, figure.data, figure.layout, settings).then(() => {
      root.dataset.drawn = String(index + 1);
      setTimeout(() => draw(index + 1), 0);
    });
  }

  const resize = (width) => boxes.forEach((box) => Plotly.relayout(box, { width: width(box), autosize: !width(box) }));
  window.addEventListener("beforeprint", () => resize(paper_width_px));
  window.addEventListener("afterprint", () => resize(() => null));
  draw(0);
})();
