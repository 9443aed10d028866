// Strip charts of the gyros: counts, truth, the difference, and what it adds up to.

import { at, clock, element, fixed } from "./dom.js";

const KEEP_S = 600;
const VIEWS = [
  { name: "difference", title: "counts − truth", decimals: 2, minimum: 3 },
  { name: "accumulated", title: "accumulated", decimals: 2, minimum: 5 },
  { name: "counts", title: "counts", decimals: 0, minimum: 4 },
  { name: "truth", title: "truth", decimals: 2, minimum: 4 },
];
/** Margins around a strip, and its height, pixels. */
const LEFT = 58;
const RIGHT = 12;
const HEIGHT = 116;
const TITLES = 22;
/** Times are drawn from a whole number of days on: an SVG has 24 bits for a number. */
const DAY_S = 86400;

/** Charts of these gyros; takes samples and faults in. `validBits` are their bits in gyro_flags. */
export function charts(gyros, validBits) {
  const times = [];
  const columns = gyros.map(() => ({ valid: [], ...Object.fromEntries(VIEWS.map((view) => [view.name, []])) }));
  const zeros = gyros.map(() => 0);
  const faults = new Map();
  let view = VIEWS[0],
    windowS = 60,
    last = null,
    baseS = 0,
    cursorS = null,
    isDrawing = false;

  for (const known of VIEWS) {
    const choice = element("input", { type: "radio", name: "view", value: known.name, checked: known === view });
    choice.addEventListener("change", () => {
      view = known;
      strips.forEach(({ chart }) => chart.reset());
      draw();
    });
    at("views").append(element("label", {}, choice, element("span", {}, known.title)));
  }
  at("window").addEventListener("change", (event) => {
    windowS = Number(event.target.value);
    strips.forEach(({ chart }) => chart.reset());
    draw();
  });
  at("zero").addEventListener("click", () => {
    zeros.splice(0, zeros.length, ...(last?.departure_arcsec ?? zeros));
    columns.forEach((column) => {
      column.accumulated = column.accumulated.map(() => null);
    });
    draw();
  });

  const strips = gyros.map((gyro, index) => {
    const value = element("output", { className: "value" }),
      sub = element("span", { className: "sub" });
    const canvas = element("div", { className: "canvas" });
    at("strips").append(
      element(
        "div",
        { className: "strip", id: `strip-${gyro}` },
        element("div", { className: "reading" }, element("b", {}, gyro), value, sub),
        canvas,
      ),
    );
    return { value, sub, ...made(canvas, index) };
  });

  function made(canvas, index) {
    const isLast = index === gyros.length - 1;
    const [width, height, bottom] = [600, HEIGHT + (isLast ? TITLES : 0), HEIGHT - 8];
    const frame = `x="${LEFT}" y="8" width="${width - LEFT - RIGHT}" height="${bottom - 8}"`;
    canvas.innerHTML = `<svg class="chart" width="100%" height="${height}" viewBox="0 0 ${width} ${height}"
      data-frame="${LEFT} 8 ${width - RIGHT} ${bottom}" data-x="0 ${windowS}" data-y="-1 1" data-step="1" data-zoom="xy"
      data-group="gyros" role="img"><g class="y axis"></g><g class="x axis"></g>
      <svg class="inside" ${frame} viewBox="${LEFT} 8 ${width - LEFT - RIGHT} ${bottom - 8}">
      <g class="data"><g class="shades"></g><path class="first"/></g><g class="marks"></g></svg><rect class="frame" ${frame}/></svg>`;
    const svg = canvas.firstChild;
    svg.setAttribute("aria-label", `Strip chart of ${gyros[index]}`);
    const chart = geuChart(svg, {
      isLive: true,
      formatX: (x) => (isLast && x + baseS >= 0 ? clock(x + baseS, 0) : ""),
      onCursor: (x) => {
        cursorS = x === null ? null : x + baseS;
        read();
      },
    });
    new ResizeObserver(() => chart.resize(Math.max(canvas.clientWidth, 100))).observe(canvas);
    const part = (name) => svg.querySelector(name);
    return { chart, path: part("path"), shades: part(".shades"), marks: part(".marks") };
  }

  /** Updates the active faults; `faults` lists armed and active ones. */
  function follow(half) {
    const acting = new Map(
      half.faults.filter(({ state }) => state === "active").map((fault) => [`${fault.id} ${fault.since_s}`, fault]),
    );
    for (const [key, fault] of faults) if (!acting.has(key)) fault.end_s ??= half.t_s - 0.5;
    for (const [key, fault] of acting) if (!faults.has(key)) faults.set(key, { ...fault, end_s: null });
    for (const [key, fault] of faults) if (fault.end_s !== null && fault.end_s < half.t_s - KEEP_S) faults.delete(key);
  }

  /** Where a fault acts on the gyro, or on all, and where the gyro was not valid, which is said on the trace as well. */
  function shade({ chart, shades, marks }, index, end, [low, high]) {
    shades.replaceChildren();
    marks.replaceChildren();
    const start = end - windowS;
    const box = (name, from, to) => {
      const [x, y, width, height] = [Math.max(from, start), low, to - Math.max(from, start), high - low];
      if (width > 0) chart.make("rect", { class: name, x: x - baseS, y, width, height }, shades);
    };
    for (const fault of faults.values()) {
      if (fault.gyro && fault.gyro !== gyros[index]) continue;
      box("fault", fault.since_s, Math.min(fault.end_s ?? end, end));
      const x = fault.since_s - baseS;
      if (fault.since_s > start) chart.make("line", { class: "fault-start", x1: x, x2: x, y1: low, y2: high }, shades);
    }
    const { valid } = columns[index];
    for (let first = valid.indexOf(false); first >= 0; ) {
      const after = valid.indexOf(true, first);
      const last = after < 0 ? times.length - 1 : after - 1;
      box("invalid", times[first] - 0.5, times[last]);
      if (times[last] > start) {
        const from = Math.max(times[first] - 0.5, start);
        const isLate = end - from < windowS * 0.12;
        const at = `${(isLate ? end : from) - baseS} ${high}`;
        const place = { class: "invalid", x: isLate ? -4 : 4, y: 14, "text-anchor": isLate ? "end" : "start" };
        chart.make("text", place, chart.make("g", { "data-at": at }, marks)).textContent = "not valid";
      }
      first = after < 0 ? -1 : valid.indexOf(false, after);
    }
  }

  /** The values beside each strip: the latest, or those at the cursor. */
  function read() {
    const isPointed = cursorS !== null && times.length > 0;
    const distance = (index) => Math.abs(times[index] - cursorS);
    let place = times.length - 1;
    if (isPointed) while (place > 0 && distance(place - 1) <= distance(place)) place -= 1;
    strips.forEach(({ value, sub }, index) => {
      const column = columns[index][view.name];
      value.textContent = fixed(column[place] ?? NaN, view.decimals);
      const isValid = columns[index].valid[place] !== false;
      sub.classList.toggle("warn", !isValid);
      const unit = isPointed ? `at ${clock(times[place])}` : view.name === "counts" ? "count" : "arcsec";
      sub.textContent = isValid ? unit : "not valid";
    });
  }

  function draw() {
    if (isDrawing) return;
    isDrawing = true;
    requestAnimationFrame(() => {
      isDrawing = false;
      at("zero").hidden = view.name !== "accumulated";
      const end = times.at(-1) ?? windowS,
        begin = Math.max(times.findIndex((t) => t >= end - windowS) - 1, 0);
      baseS = Math.floor((times[0] ?? 0) / DAY_S) * DAY_S;
      strips.forEach((strip, index) => {
        const values = columns[index][view.name].slice(begin);
        const known = values.filter((value) => value !== null);
        const range = around(Math.min(...known), Math.max(...known), view.minimum);
        shade(strip, index, end, range);
        const points = values.map((value, place) =>
          value === null ? "" : `${(values[place - 1] ?? null) === null ? "M" : "L"}${times[begin + place] - baseS} ${value}`,
        );
        strip.path.setAttribute("d", points.join(""));
        strip.chart.show([end - windowS - baseS, end - baseS], range);
      });
      read();
    });
  }

  function row(t, values) {
    times.push(t);
    columns.forEach((column, index) =>
      Object.keys(column).forEach((name) => column[name].push(values?.[index][name] ?? null)),
    );
  }

  function clear() {
    times.length = 0;
    columns.forEach((column) =>
      Object.values(column).forEach((values) => {
        values.length = 0;
      }),
    );
  }

  function add(half) {
    // Missing samples are gaps.
    if (last && times.length && half.half_second > last.half_second + 1) row((last.t_s + half.t_s) / 2, null);
    last = half;
    row(
      half.t_s,
      gyros.map((_, index) => {
        const counts = half.increments[index],
          truth = half.true_arcsec[index];
        // Summed by the unit: a run faster than real time does not publish every sample.
        const accumulated = half.departure_arcsec[index] - zeros[index];
        const valid = ((half.gyro_flags >> validBits[index]) & 1) === 1;
        return { counts, truth, difference: counts - truth, accumulated, valid };
      }),
    );
  }

  draw();
  return {
    /** Draws what the unit did before the page was there. */
    fill(history) {
      clear();
      history.forEach(add);
      draw();
    },
    take(half) {
      if (last && half.half_second <= last.half_second) {
        clear();
        zeros.fill(0);
        faults.clear();
      }
      add(half);
      const old = times.findIndex((t) => t >= half.t_s - KEEP_S);
      if (old > 0) {
        times.splice(0, old);
        columns.forEach((column) => Object.values(column).forEach((values) => values.splice(0, old)));
      }
      follow(half);
      draw();
    },
  };
}

/** A range with a margin, never narrower than `minimum`. */
function around(low, high, minimum) {
  if (!Number.isFinite(low) || !Number.isFinite(high)) return [-minimum, minimum];
  const half = Math.max((high - low) * 0.56, minimum / 2),
    middle = (high + low) / 2;
  return [middle - half, middle + half];
}
