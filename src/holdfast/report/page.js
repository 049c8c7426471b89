// Draws one figure after the other, so that the page can be read meanwhile; `data-drawn` on <html> counts them.
// On a page about one run (`data-start`, `data-end`: seconds) plots over time show the same stretch, and a click on an
// event, or on a plot, marks its time in all of them and its place on the map.
(function () {
  "use strict";
  const root = document.documentElement;
  const boxes = Array.from(document.querySelectorAll(".plot"));
  const touch = window.matchMedia("(pointer: coarse)").matches;
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const paper_width_px = (box) => (box.closest(".row") ? 320 : 680); // A4 within the margins of the style sheet
  const settings = { responsive: true, displayModeBar: false, doubleClick: "reset" }; // drag zooms
  const in_the_dark = { "#1d2630": "#dfe6ee", "#e6e9ee": "#2c3742", "#ffffff": "#12181f", "#5f6b7a": "#9dabba",
    "#0072b2": "#4aa8e0", "#56b4e9": "#d4ecff", "#7a5195": "#b28ad0" };
  const LONG_NAME = 12, NARROW_PX = 500;
  root.dataset.drawn = "0";
  root.dataset.errors = "";
  window.addEventListener("error", (event) => { root.dataset.errors += event.message + "\n"; });
  document.addEventListener("securitypolicyviolation", (event) => {
    root.dataset.errors += event.violatedDirective + " " + event.blockedURI + "\n";
  });
  window.addEventListener("unhandledrejection", (event) => { root.dataset.errors += event.reason + "\n"; });

  // --- the time of the run
  const clock = root.dataset.start === undefined ? null : { start: +root.dataset.start, end: +root.dataset.end };
  const is_utc = clock !== null && clock.start > 1e9; // else stamps count from elsewhere than 1970
  const STEPS_S = [1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800,
    3600, 7200, 14400, 28800, 86400];
  let view = clock && [0, clock.end];
  let marked = null; // time [s] that is marked
  let following = 0; // plots that are being moved by this script, not by a hand
  const over_time = (box) => clock !== null && box.figure && box.figure.layout.meta.over_time;
  const track_of = (box) => clock !== null && box.figure && box.figure.layout.meta.track;
  const utc = (time, digits) => new Date((clock.start + time) * 1000).toISOString().slice(11, 19 + digits);

  // axis labels: seconds since the start, and the time of day below them
  function ticks(box) {
    const span = view[1] - view[0];
    const step = STEPS_S.find((s) => span / s <= Math.max(2, box.clientWidth / 95)) || span / 4;
    const digits = step < 1 ? Math.ceil(-Math.log10(step)) : 0;
    const values = [];
    for (let k = Math.ceil(view[0] / step); k * step <= view[1] && values.length < 50; k++) values.push(k * step);
    const text = values.map((t) => t.toFixed(digits) + (is_utc ? "<br>" + utc(t, digits && Math.min(digits, 3) + 1) : ""));
    return { "xaxis.range": view.slice(), "xaxis.tickvals": values, "xaxis.ticktext": text };
  }
  function lines(box) {
    const line = { type: "line", xref: "x", yref: "paper", x0: marked, x1: marked, y0: 0, y1: 1,
      line: { color: box.figure.layout.font.color, width: 1.5 } };
    return marked === null ? box.shapes : box.shapes.concat([line]);
  }
  function follow(box, change) {
    following++;
    Plotly.relayout(box, change).then(() => { following--; });
  }
  function show(start, end) {
    view = [start, end];
    boxes.filter(over_time).forEach((box) => follow(box, ticks(box)));
  }
  function mark(time) {
    marked = time;
    boxes.filter(over_time).forEach((box) => follow(box, { shapes: lines(box) }));
    boxes.filter(track_of).forEach((box) => {
      const at = place(box, time);
      Plotly.restyle(box, { x: [[at.x]], y: [[at.y]] }, [box.data.length - 1]);
    });
  }
  function place(box, time) {
    const { t, x, y } = track_of(box);
    let k = t.findIndex((value) => value >= time);
    if (k < 0) k = t.length - 1;
    return { x: x[k], y: y[k] };
  }
  function go_to(time) {
    const half = Math.min(10, clock.end / 2);
    show(time - half, time + half);
    mark(time);
    boxes.filter(track_of).forEach((box) => {
      const { t, x, y } = track_of(box), at = place(box, time);
      const near = t.map((value, k) => (Math.abs(value - time) <= half ? Math.hypot(x[k] - at.x, y[k] - at.y) : 0));
      const reach = Math.max(2, 1.3 * Math.max(...near));
      follow(box, { "xaxis.range": [at.x - reach, at.x + reach], "yaxis.range": [at.y - reach, at.y + reach] });
    });
  }
  function show_all() {
    marked = null;
    document.querySelectorAll("tr[aria-current]").forEach((row) => row.removeAttribute("aria-current"));
    show(0, clock.end);
    mark(null);
    boxes.filter(track_of).forEach((box) => {
      follow(box, { "xaxis.range": box.extent[0].slice(), "yaxis.range": box.extent[1].slice() });
    });
  }
  function listen(box) {
    box.on("plotly_relayout", (change) => {
      if (following) return;
      if ("xaxis.range[0]" in change) show(+change["xaxis.range[0]"], +change["xaxis.range[1]"]);
      else if ("xaxis.range" in change) show(...change["xaxis.range"].map(Number));
      else if (change["xaxis.autorange"]) show(0, clock.end);
    });
    box.on("plotly_click", (event) => mark(+event.points[0].x));
  }
  if (clock) {
    document.getElementById("all").addEventListener("click", show_all);
    document.querySelectorAll("tr[data-time]").forEach((row) => {
      const pick = () => {
        document.querySelectorAll("tr[aria-current]").forEach((other) => other.removeAttribute("aria-current"));
        row.setAttribute("aria-current", "true");
        go_to(+row.dataset.time);
      };
      row.addEventListener("click", pick);
      row.addEventListener("keydown", (event) => { if (event.key === "Enter") pick(); });
    });
  }

  // --- drawing
  function figure_of(box, is_dark) {
    let text = document.getElementById(box.dataset.figure).textContent;
    if (is_dark) text = text.replace(/#(1d2630|e6e9ee|ffffff|5f6b7a|0072b2|56b4e9|7a5195)/g, (colour) => in_the_dark[colour]);
    const figure = JSON.parse(text);
    figure.layout.meta = figure.layout.meta || {};
    if (touch) figure.layout.dragmode = false; // a finger scrolls the page
    const is_long = (y) => typeof y === "string" && y.length > LONG_NAME;
    if (figure.data.some((trace) => (trace.y || []).some?.(is_long)) && box.clientWidth < NARROW_PX) // beside the axis they would leave no room for the plot
      Object.assign(figure.layout.yaxis, { ticklabelposition: "inside top", tickfont: { size: 10 } });
    box.figure = figure;
    box.shapes = figure.layout.shapes || [];
    if (over_time(box)) {
      const axis = ticks(box);
      const date = new Date(clock.start * 1000);
      Object.assign(figure.layout.xaxis, { range: axis["xaxis.range"], tickvals: axis["xaxis.tickvals"],
        ticktext: axis["xaxis.ticktext"] });
      if (is_utc) figure.layout.xaxis.title.text = "time [s], UTC of " + date.toISOString().slice(0, 10);
      figure.layout.shapes = lines(box);
    }
    if (track_of(box)) {
      const at = marked === null ? { x: null, y: null } : place(box, marked);
      box.extent = [figure.layout.xaxis.range, figure.layout.yaxis.range];
      figure.data.push({ x: [at.x], y: [at.y], mode: "markers", name: "marked time", showlegend: false,
        marker: { size: 13, symbol: "cross-thin", line: { width: 3, color: figure.layout.font.color } } });
    }
    return figure;
  }
  function draw(index) {
    if (index === boxes.length) return;
    const box = boxes[index];
    const figure = figure_of(box, dark.matches);
    Plotly.newPlot(box, figure.data, figure.layout, settings).then(() => {
      if (over_time(box)) listen(box);
      root.dataset.drawn = String(index + 1);
      setTimeout(() => draw(index + 1), 0);
    });
  }
  function repaint(is_dark) {
    boxes.filter((box) => box.figure).forEach((box) => {
      const figure = figure_of(box, is_dark);
      Plotly.react(box, figure.data, figure.layout, settings);
    });
  }

  const resize = (width) => boxes.forEach((box) => Plotly.relayout(box, { width: width(box), autosize: !width(box) }));
  dark.addEventListener("change", (event) => repaint(event.matches));
  window.addEventListener("beforeprint", () => { if (dark.matches) repaint(false); resize(paper_width_px); });
  window.addEventListener("afterprint", () => { if (dark.matches) repaint(true); resize(() => null); });

  // --- where in the contents the reader is
  const links = new Map(Array.from(document.querySelectorAll("nav a")).map((link) => [link.hash.slice(1), link]));
  const reading = new IntersectionObserver((entries) => {
    entries.filter((entry) => entry.isIntersecting).forEach((entry) => {
      links.forEach((link) => link.removeAttribute("aria-current"));
      links.get(entry.target.querySelector("h2").id).setAttribute("aria-current", "true");
    });
  }, { rootMargin: "-20% 0px -70% 0px" });
  document.querySelectorAll("section").forEach((section) => reading.observe(section));
  draw(0);
})();
