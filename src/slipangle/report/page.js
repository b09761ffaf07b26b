/* Draws the page's figures from the JSON beside them, in light or dark, for screen or paper. */
(() => {
  "use strict";
  const settings = JSON.parse(document.getElementById("figure-settings").textContent);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const plots = Array.from(document.querySelectorAll(".plot"));
  let printing = false;

  function coloured(text) {
    if (!dark.matches || printing) return text;
    return text.replace(settings.pattern, (light) => settings.dark[light]);
  }
  settings.pattern = new RegExp(
    Object.keys(settings.dark).map((c) => c.replace(/[()]/g, "\\$&")).join("|"), "g");

  function specification(plot) {
    const spec = JSON.parse(coloured(document.getElementById(plot.id + "-data").textContent));
    const layout = spec.layout;
    if (layout.meta && layout.meta.ratio) { /* axes of equal scale: no empty ground above and below */
      const height = layout.meta.ratio * (plot.clientWidth - 80) + layout.meta.frame;
      layout.height = Math.round(Math.min(Math.max(height, 240), 640));
      plot.dataset.width = plot.clientWidth;
    }
    layout.template = JSON.parse(coloured(JSON.stringify(settings.template)));
    layout.autosize = true;
    if (plot.clientWidth < 520) narrow(layout);
    plot.style.height = layout.height + "px";
    const touch = window.matchMedia("(hover: none)").matches;
    if (touch) layout.dragmode = false; /* a finger on a figure scrolls the page */
    return {
      data: spec.data,
      layout: layout,
      config: { displaylogo: false, responsive: !printing, displayModeBar: touch ? false : "hover",
        modeBarButtonsToRemove: ["select2d", "lasso2d"] },
    };
  }

  function narrow(layout) {
    const base = layout.template.layout;
    base.font.size = 12;
    base.margin = { l: 52, r: 8, t: base.margin.t, b: base.margin.b };
    for (const key of ["xaxis", "yaxis"]) base[key].title.font.size = 12;
    base.xaxis.nticks = 5;
    if (layout.meta && layout.meta.columns > 2) beside(layout, layout.meta.columns);
  }

  /* Panels of many columns: two beside each other. */
  function beside(layout, columns) {
    const count = Object.keys(layout).filter((key) => /^xaxis\d*$/.test(key)).length;
    const before = Math.ceil(count / columns), rows = Math.ceil(count / 2), gap = 0.36 / rows;
    const high = (1 - gap * (rows - 1)) / rows;
    for (let k = 0; k < count; k++) {
      const number = k ? String(k + 1) : "", left = k % 2 ? 0.55 : 0, top = 1 - Math.floor(k / 2) * (high + gap);
      layout["xaxis" + number].domain = [left, left + 0.45];
      const upright = layout["yaxis" + number];
      upright.domain = [Math.max(top - high, 0), top];
      upright.showticklabels = k % 2 === 0;
    }
    layout.height = Math.round(layout.height * rows / before);
  }

  /* The library is packed in the page: unpacked once, when the first figure is near or nothing else is to be done, then
     run as any other script. */
  let unpacking = null;
  async function unpack() {
    const packed = document.getElementById("plotly");
    if (!packed) return;
    const bytes = Uint8Array.from(atob(packed.textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
  }
  function unpacked() {
    unpacking = unpacking || unpack().catch((error) => {
      for (const plot of plots) plot.textContent = "This browser cannot unpack the figures: " + error.message;
    });
    return unpacking;
  }

  function draw(plot, spec = specification(plot)) {
    if (!window.Plotly) return undefined;
    const done = window.Plotly.react(plot, spec.data, spec.layout, spec.config);
    link(plot, (spec.layout.meta || {}).drive);
    return done;
  }

  /* Figures and map of one drive, and the drive that plays, show the same instant. What is pointed at asks the drive for
     it ("askdrive"), which tells all ("drive"). A figure that only follows asks for nothing. */
  function link(plot, by) {
    if (!by || plot.dataset.linked) return;
    plot.dataset.linked = by;
    plot.on("plotly_hover", (event) => {
      const p = event.points[0];
      const detail = by === "time" ? { time: p.x, from: plot } : { X: p.x, Y: p.y, from: plot };
      document.dispatchEvent(new CustomEvent("askdrive", { detail }));
    });
  }
  document.addEventListener("drive", (event) => {
    const { time, X, Y, from } = event.detail;
    for (const plot of near) {
      const by = plot.dataset.linked;
      if (!by || plot === from) continue;
      if (by === "time") window.Plotly.Fx.hover(plot, { xval: time }, ["xy"]);
      else window.Plotly.Fx.hover(plot, [nearest(plot, X, Y)]);
    }
  });
  function nearest(plot, X, Y) { /* point of the driven path */
    const curve = plot.data.findIndex((trace) => trace.name === "centre of gravity");
    const { x, y } = plot._fullData[curve];
    let best = Infinity, found = 0;
    for (let k = 0; k < x.length; k++) {
      const d = (x[k] - X) ** 2 + (y[k] - Y) ** 2;
      if (d < best) [best, found] = [d, k];
    }
    return { curveNumber: curve, pointNumber: found };
  }

  /* Figures are drawn when they come near the window, one after another, so that the page answers in between. */
  const near = new Set(), drawn = new Set();
  let drawing = false;
  async function drawNear() {
    if (drawing) return;
    drawing = true;
    await unpacked();
    for (const plot of plots) {
      if (!near.has(plot) || drawn.has(plot)) continue;
      drawn.add(plot);
      draw(plot);
      await new Promise((next) => window.setTimeout(next, 0));
    }
    drawing = false;
    if (Array.from(near).some((plot) => !drawn.has(plot))) drawNear();
  }
  function drawAgain() {
    drawn.clear();
    if (window.Plotly) drawNear();
  }
  const approach = new IntersectionObserver((entries) => {
    for (const e of entries) e.isIntersecting ? near.add(e.target) : near.delete(e.target);
    if (near.size) drawNear();
  }, { rootMargin: "700px 0px" });
  for (const plot of plots) approach.observe(plot);

  let wasNarrow = window.innerWidth < 600;
  function onResize() {
    const now = window.innerWidth < 600;
    if (now !== wasNarrow) drawAgain();
    wasNarrow = now;
    for (const plot of drawn) { /* axes of equal scale: another width is another height */
      if (plot.dataset.width && Number(plot.dataset.width) !== plot.clientWidth) drawn.delete(plot);
    }
    if (near.size) drawNear();
  }

  /* Figures shrink into what is left of a sheet, or grow where the next one does not fit, so that no sheet ends half
     empty. Long paragraphs and tables break as they fall. Gives each figure with its height. */
  const SHEET = 1017, SPARE = 16; /* A4 without its margins; kept free [px] */
  const LEAST = 0.55, MOST = 1.35, LOW = 230, SHORT = 60; /* of a figure, a paragraph that does not break [px] */
  function fitSheets() {
    const from = document.querySelector(".layout").getBoundingClientRect().top, rows = [];
    for (const part of document.querySelectorAll("main :is(.plot, .drawing, .verdict, tbody tr, p, li, pre)")) {
      const box = part.getBoundingClientRect(), plot = part.matches(".plot") ? part : null, last = rows[rows.length - 1];
      if (!box.height || part.parentElement.closest(".verdict")) continue;
      if (part.matches("p, li, pre") && (box.height > SHORT || part.matches(".lead"))) continue;
      if (plot && last && last.plots.length && Math.abs(last.top - box.top + from) < 2) {
        last.plots.push(plot); /* beside each other */
        continue;
      }
      rows.push({ top: box.top - from, head: headOf(part) - from, height: box.height, plots: plot ? [plot] : [] });
    }
    let sheet = 0, shift = 0, above = [];
    for (const row of rows) {
      row.top += shift;
      row.head += shift;
      while (row.head >= sheet + SHEET) [sheet, above] = [sheet + SHEET, []];
      const room = sheet + SHEET - row.top;
      if (row.height > room) {
        if (row.plots.length && room - SPARE >= Math.max(LEAST * row.height, LOW)) {
          shift += room - SPARE - row.height;
          row.height = room - SPARE;
        } else {
          const left = sheet + SHEET - row.head - SPARE, most = above.reduce((sum, r) => sum + r.height, 0);
          const share = Math.min(Math.max(left, 0) / most, MOST - 1);
          for (const r of above) r.height *= 1 + share;
          if (most) shift += share * most;
          [sheet, above] = [row.head + (most ? share * most : 0), []];
        }
      }
      if (row.plots.length) above.push(row);
    }
    return rows.flatMap((row) => row.plots.map((plot) => [plot, Math.round(row.height)]));
  }
  /* Where what must stand on the same sheet begins: headings, and the head of a table. */
  function headOf(part) {
    let first = part.matches("tr") ? (part.previousElementSibling ? part : part.closest(".scroll")) : part;
    for (let block = first; block && !block.matches("section"); block = block.parentElement) {
      let before = block.previousElementSibling;
      while (before && before.matches("h2, h3, .lead")) [first, before] = [before, before.previousElementSibling];
      if (before || !block.matches(":is(.block, .playback, .scroll, .plot, .drawing)")) break;
    }
    if (first.matches("section > :first-child")) first = first.parentElement;
    return first.getBoundingClientRect().top;
  }

  function beforePrint() {
    printing = true;
    document.documentElement.classList.add("printing"); /* the paper's width, before measuring */
    const specs = new Map(plots.map((plot) => [plot, specification(plot)]));
    for (const [plot, height] of fitSheets()) {
      specs.get(plot).layout.height = height;
      plot.style.height = height + "px";
    }
    for (const [plot, spec] of specs) draw(plot, spec);
  }
  function afterPrint() {
    printing = false;
    document.documentElement.classList.remove("printing");
    drawAgain();
  }

  const links = new Map(Array.from(document.querySelectorAll("nav a")).map((a) => [a.hash.slice(1), a]));
  const seen = new Set();
  const watcher = new IntersectionObserver((entries) => {
    for (const e of entries) e.isIntersecting ? seen.add(e.target.id) : seen.delete(e.target.id);
    const first = Array.from(links.keys()).find((id) => seen.has(id));
    if (!first) return;
    for (const [id, a] of links) {
      if (id === first) a.setAttribute("aria-current", "location");
      else a.removeAttribute("aria-current");
    }
  }, { rootMargin: "-15% 0px -55% 0px" });
  document.querySelectorAll("main section").forEach((s) => watcher.observe(s));

  window.addEventListener("beforeprint", beforePrint);
  window.addEventListener("afterprint", afterPrint);
  window.addEventListener("resize", onResize);
  dark.addEventListener("change", drawAgain);
  const copy = document.getElementById("copy");
  if (copy) copy.addEventListener("click", () => {
    const code = document.getElementById("again");
    const chosen = document.createRange();
    chosen.selectNodeContents(code);
    window.getSelection().removeAllRanges();
    window.getSelection().addRange(chosen);
    const done = () => { copy.textContent = "Copied"; };
    if (navigator.clipboard) navigator.clipboard.writeText(code.textContent).then(done, () => {});
    else if (document.execCommand("copy")) done();
  });

  onResize();
  const idle = window.requestIdleCallback || ((act) => window.setTimeout(act, 200));
  window.addEventListener("load", () => window.setTimeout(() => idle(unpacked), 300)); /* so that it prints at once */
})();
