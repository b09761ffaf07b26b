/* Drives that play: the slider is the time, the car and its predicted path follow it. Where there is a program the
   reader drives: each setting drives the whole manoeuvre anew, and the result plays as the recorded drive does. */
(() => {
  "use strict";

  function player(block) {
    const part = (name) => block.querySelector(name);
    const drawing = part("svg.drawing");
    const [left, top] = [Number(drawing.dataset.x), Number(drawing.dataset.y)];
    const [play, slider, speed, said] = [".play", ".controls input", "select", ".controls output"].map(part);
    const circles = Array.from(block.querySelectorAll(".circle"));
    const x = (v) => (v - left).toFixed(2), y = (v) => (top - v).toFixed(2);
    let frames = JSON.parse(part(".frames").textContent);
    let started = null, at = 0, recorded = true; /* at: s, what is shown; whether it is what the page's figures show */

    /* Where the whole path would be less than LOW pixels high, as on a phone, a part of it that is HIGH follows the car. */
    const LOW = 30, HIGH = 60;
    const [wide, high] = drawing.getAttribute("viewBox").split(" ").slice(2).map(Number);
    let printing = false;
    function frame(X) {
      const across = drawing.clientWidth, whole = printing || !across || across * high / wide >= LOW;
      const seen = whole ? wide : Math.min(wide, high * across / HIGH);
      const from = Math.min(Math.max(X - left - 0.3 * seen, 0), wide - seen);
      drawing.setAttribute("viewBox", `${from.toFixed(2)} 0 ${seen.toFixed(2)} ${high}`);
    }

    const way = (X, Y) => X.map((v, k) => `${k ? "L" : "M"}${x(v)} ${y(Y[k])}`).join("");
    const pose = (drive, k, share) => {
      const j = Math.min(k + 1, drive.t.length - 1), mix = (v) => v[k] + share * (v[j] - v[k]);
      const turn = (-mix(drive.psi) * 180 / Math.PI).toFixed(2);
      return `translate(${x(mix(drive.X))} ${y(mix(drive.Y))}) rotate(${turn})`;
    };
    const place = (drive, time) => {
      let k = 0;
      while (k < drive.t.length - 1 && drive.t[k + 1] <= time + 1e-9) k += 1;
      const next = drive.t[k + 1];
      return [k, next === undefined ? 0 : Math.max(0, (time - drive.t[k]) / (next - drive.t[k]))];
    };
    const end = () => Math.max(frames.t[frames.t.length - 1], frames.beside ? frames.beside.t.slice(-1)[0] : 0);

    function steering(drive) {
      return drive.steering.map((v, k) =>
        `${k ? "L" : "M"}${(600 * drive.t[k] / end()).toFixed(1)} ${(45 - 37 * v / frames.limit).toFixed(1)}`).join("");
    }

    function still() { /* what does not move while it plays */
      const other = frames.beside;
      if (part(".beside")) part(".beside").setAttribute("d", other ? way(other.X, other.Y) : "");
      if (part(".strip")) {
        part(".steered").setAttribute("d", steering(frames));
        part(".besides").setAttribute("d", other && other.steering ? steering(other) : "");
      }
      circles.forEach((circle, a) => circle.querySelector(".trace").setAttribute("d", frames.axles.map((f, k) =>
        `${k ? "L" : "M"}${(-f[2 * a + 1]).toFixed(3)} ${(-f[2 * a]).toFixed(3)}`).join("")));
      slider.max = frames.t.length - 1;
    }

    function show(time, exact, from) {
      at = time;
      const [k, share] = place(frames, time), other = frames.beside;
      if (!exact) slider.value = k;
      part(".now").setAttribute("transform", pose(frames, k, exact ? 0 : share));
      frame(frames.X[k] + (exact ? 0 : share) * ((frames.X[k + 1] ?? frames.X[k]) - frames.X[k]));
      if (other && part(".other")) part(".other").setAttribute("transform", pose(other, ...place(other, time)));
      const ahead = frames.horizon[k] || [];
      let d = "";
      for (let i = 0; i + 1 < ahead.length; i += 2) d += `${i ? "L" : "M"}${x(ahead[i])} ${y(ahead[i + 1])}`;
      part(".horizon").setAttribute("d", d);
      circles.forEach((circle, a) => {
        const used = frames.axles[k];
        if (used) circle.querySelector(".dot").setAttribute("transform", `translate(${-used[2 * a + 1]} ${-used[2 * a]})`);
      });
      const now = (600 * time / end()).toFixed(1);
      if (part(".cursor")) part(".cursor").setAttribute("d", `M${now} 2V88`);
      said.textContent = `${frames.t[k].toFixed(2)} s: ${frames.said[k]}`;
      slider.setAttribute("aria-valuetext", said.textContent);
      const detail = { time: frames.t[k], X: frames.X[k], Y: frames.Y[k], from };
      if (recorded) document.dispatchEvent(new CustomEvent("drive", { detail }));
    }
    document.addEventListener("askdrive", (event) => { /* a figure of the recorded drive is pointed at */
      const { time, X, Y, from } = event.detail;
      if (!recorded || started !== null) return;
      const far = (k) => (frames.X[k] - X) ** 2 + (frames.Y[k] - Y) ** 2;
      const seen = time === undefined ? frames.t[frames.t.map((_, k) => k).reduce((a, b) => (far(b) < far(a) ? b : a))] : time;
      show(seen, false, from);
    });

    window.addEventListener("resize", () => show(at, true));
    for (const [event, now] of [["beforeprint", true], ["afterprint", false]])
      window.addEventListener(event, () => { printing = now; show(at, true); });

    const stop = () => { started = null; play.textContent = "Play"; };
    const go = (now) => {
      if (started === null) return;
      const time = started.t + Number(speed.value) * (now - started.now) / 1000;
      const last = frames.t[frames.t.length - 1];
      show(Math.min(Math.max(time, started.t), last));
      if (time >= last) stop();
      else window.requestAnimationFrame(go);
    };
    const begin = () => {
      if (at >= frames.t[frames.t.length - 1]) at = 0;
      started = { t: at, now: performance.now() };
      play.textContent = "Pause";
      window.requestAnimationFrame(go);
    };
    play.addEventListener("click", () => (started === null ? begin() : stop()));
    slider.addEventListener("input", () => { stop(); show(frames.t[Number(slider.value)], true); });
    speed.addEventListener("change", () => { if (started !== null) begin(); });
    still();
    show(0, true);
    block.dataset.ready = "yes";

    return {
      limit: frames.limit,
      load(other) { /* another drive in place of this one, from where it is */
        frames = other;
        recorded = false;
        block.classList.add("driven");
        part(".way").setAttribute("d", way(frames.X, frames.Y));
        still();
        show(Math.min(at, frames.t[frames.t.length - 1]));
        if (started !== null) begin();
      },
    };
  }

  /* ---- the reader drives ---------------------------------------------------------------------------------------- */

  const WHY = ["", "", "; it leaves the path by 20 m and stops", "; it does not arrive in time", "; its numbers overflow"];

  async function unpacked(text) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).arrayBuffer();
  }

  /* Drives the whole manoeuvre; frames as those of a recorded drive, and how it went. */
  function drive(program, about, values, limit) {
    const e = program.exports, began = performance.now(), horizon = [];
    new Float64Array(e.memory.buffer, e.live_settings(), values.length).set(values);
    e.live_begin();
    const [size, nodes, X, Y] = about.state;
    let end = 0, planning = 0, slowest = 0, old = 0;
    while (!end) {
      const before = performance.now();
      e.live_plan();
      const took = performance.now() - before;
      planning += took;
      slowest = Math.max(slowest, took);
      old += e.live_age() > 0;
      const ahead = new Float64Array(e.memory.buffer, e.live_predicted(), size * nodes), line = [];
      for (let k = 0; k < nodes; k += 4) line.push(ahead[k * size + X], ahead[k * size + Y]);
      horizon.push(line);
      end = e.live_go();
    }
    const count = e.live_count(), rows = new Float64Array(e.memory.buffer, e.live_rows(), count * about.row);
    const [turn, angle] = about.angle;
    const angled = (v) => (angle === "deg" ? `${(turn * v).toFixed(1)}°` : `${v.toFixed(3)} rad`);
    const made = { t: [], X: [], Y: [], psi: [], said: [], steering: [], axles: [], horizon: [], limit };
    let squares = 0, most = 0, seen = -1;
    for (let k = 0; k < count; k++) {
      const row = rows.subarray(k * about.row, (k + 1) * about.row);
      squares += row[2] * row[2];
      most = Math.max(most, Math.abs(row[2]));
      if (row[8] === seen && k < count - 1) continue;
      seen = row[8];
      made.t.push(row[0]);
      made.X.push(row[4]);
      made.Y.push(row[5]);
      made.psi.push(row[6]);
      made.steering.push(row[7]);
      made.axles.push(Array.from(row.subarray(9)));
      made.horizon.push(horizon[seen]);
      const [fast, speed] = about.speed;
      made.said.push(`steering ${angled(row[7])} of ±${angled(limit)}, ${(fast * row[3]).toFixed(1)} ${speed}, ` +
        `${(100 * row[2]).toFixed(1)} cm from the path`);
    }
    const plans = e.live_plans();
    return { frames: made, end, plans, old, rmse: Math.sqrt(squares / count), most, slowest,
      mean: planning / plans, took: performance.now() - began };
  }

  async function alive(block, shown) {
    const field = block.querySelector(".live");
    if (!field || typeof WebAssembly !== "object") return;
    const about = JSON.parse(block.querySelector(".about").textContent);
    const bytes = await unpacked(block.querySelector(".program").textContent);
    const program = (await WebAssembly.instantiate(bytes, {})).instance;
    if (program.exports._initialize) program.exports._initialize();
    const inputs = Array.from(field.querySelectorAll("input"));
    const value = (s, at) => (s.ratio ? s.low * (s.high / s.low) ** at : s.low + at * (s.high - s.low));
    const share = (s) => (s.ratio ? Math.log(s.value / s.low) / Math.log(s.high / s.low) : (s.value - s.low) / (s.high - s.low));
    const now = about.sliders.map((s) => s.value);
    const tell = () => inputs.forEach((input) => {
      const k = Number(input.dataset.at), s = about.sliders[k];
      const text = `${Number(now[k].toPrecision(3))}${s.unit ? " " + s.unit : ""}`;
      input.nextElementSibling.textContent = text;
      input.setAttribute("aria-valuetext", text);
    });
    const rest = () => {
      about.sliders.forEach((s, k) => { now[k] = s.value; });
      inputs.forEach((input) => { input.value = Math.round(200 * share(about.sliders[Number(input.dataset.at)])); });
      tell();
    };
    const run = () => drive(program, about, now.map((v, k) => v * about.sliders[k].scale), shown.limit);
    const say = (r) => {
      const old = r.old ? `, ${r.old} command${r.old > 1 ? "s" : ""} from an older plan` : "";
      field.querySelector(".outcome").textContent = `${(100 * r.rmse).toFixed(1)} cm (RMS) from the path, ` +
        `${(100 * r.most).toFixed(0)} cm at most${WHY[r.end]}${old}. Solver on your machine: ` +
        `${r.mean.toFixed(2)} ms a plan on average, ${r.slowest.toFixed(1)} ms at most, of ${(1000 * about.dt).toFixed(0)} ms; ` +
        `all ${r.plans} plans and the car took ${r.took.toFixed(0)} ms.`;
    };
    const heading = block.querySelector("h3"), jobs = heading.textContent;
    let beside = null, due = false;
    const begin = () => { /* the job's own drive, which also warms it up */
      if (beside) return;
      const first = run();
      beside = { ...first.frames, label: "the job's settings" };
      say(first);
    };
    rest();
    const details = block.querySelector("details");
    details.addEventListener("toggle", begin);
    if (details.open) begin();
    const again = () => {
      due = false;
      begin();
      const r = run(), own = now.some((v, k) => v !== about.sliders[k].value);
      say(r);
      heading.textContent = own ? "Your drive, seen from above" : jobs;
      shown.load({ ...r.frames, beside });
    };
    const later = () => { tell(); if (!due) { due = true; window.requestAnimationFrame(again); } };
    for (const input of inputs) {
      input.addEventListener("input", () => {
        const k = Number(input.dataset.at);
        now[k] = value(about.sliders[k], Number(input.value) / 200);
        later();
      });
    }
    field.querySelector(".reset").addEventListener("click", () => { rest(); later(); });
    field.hidden = false;
    block.querySelector("summary").textContent =
      "Drive it yourself: speed, friction, delay, mass and weights; steering and tires against their limits";
  }

  const idle = window.requestIdleCallback || ((act) => window.setTimeout(act, 200));
  for (const block of document.querySelectorAll(".playback")) {
    const shown = player(block);
    idle(() => alive(block, shown).catch(() => {})); /* without WebAssembly the recorded drive plays */
  }
})();
