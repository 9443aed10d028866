// Strip charts of the gyros: counts, truth, the difference, and what it adds up to.

import { at, clock, element, fixed } from "./dom.js";

const KEEP_S = 600;
const VIEWS = [
  { name: "difference", title: "counts − truth", decimals: 2, least: 3 },
  { name: "accumulated", title: "accumulated", decimals: 2, least: 5 },
  { name: "counts", title: "counts", decimals: 0, least: 4 },
  { name: "truth", title: "truth", decimals: 2, least: 4 },
];
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Charts of these gyros; takes half seconds and faults in. `validBits` are their bits in gyro_flags. */
export function charts(gyros, validBits) {
  const times = [];
  const columns = gyros.map(() => ({ valid: [], ...Object.fromEntries(VIEWS.map((view) => [view.name, []])) }));
  const zeros = gyros.map(() => 0);
  const faults = new Map();
  let view = VIEWS[0],
    windowS = 60,
    last = null,
    isDrawing = false;

  for (const known of VIEWS) {
    const choice = element("input", { type: "radio", name: "view", value: known.name, checked: known === view });
    choice.addEventListener("change", () => {
      view = known;
      draw();
    });
    at("views").append(element("label", {}, choice, element("span", {}, known.title)));
  }
  at("window").addEventListener("change", (event) => {
    windowS = Number(event.target.value);
    draw();
  });
  at("zero").addEventListener("click", () => {
    zeros.splice(0, zeros.length, ...(last?.departure_arcsec ?? zeros));
    columns.forEach((column) => {
      column.accumulated = column.accumulated.map(() => null);
    });
    draw();
  });

  const hasCharts = typeof uPlot === "function";
  at("no-charts").hidden = hasCharts;
  const strips = gyros.map((gyro, index) => {
    const value = element("output", { className: "value" }),
      sub = element("span", { className: "sub" });
    const canvas = element("div", { className: "canvas", role: "img", ariaLabel: `Strip chart of ${gyro}` });
    at("strips").append(
      element(
        "div",
        { className: "strip", id: `strip-${gyro}` },
        element("div", { className: "reading" }, element("b", {}, gyro), value, sub),
        canvas,
      ),
    );
    const plot = hasCharts ? plotted(canvas, index) : null;
    return { value, sub, plot };
  });

  function plotted(canvas, index) {
    const isLast = index === gyros.length - 1;
    const font = "11px ui-monospace, 'DejaVu Sans Mono', monospace";
    const axis = {
      stroke: () => colour("--soft"),
      font,
      ticks: { show: false },
      grid: { stroke: () => colour("--rule"), width: 1 },
    };
    const plot = new uPlot(
      {
        width: Math.max(canvas.clientWidth, 100),
        height: isLast ? 138 : 116,
        legend: { show: false },
        padding: [8, 12, isLast ? 0 : 8, 0],
        cursor: { sync: { key: "gyros" }, y: false, drag: { x: false, y: false }, points: { size: 5 } },
        scales: {
          x: {
            time: false,
            range: () => {
              const end = times.at(-1) ?? windowS;
              return [end - windowS, end];
            },
          },
          y: { range: (_, low, high) => around(low, high, view.least) },
        },
        axes: [
          {
            ...axis,
            size: isLast ? 22 : 0,
            values: (_, splits) => splits.map((t) => (t < 0 || !isLast ? "" : clock(t, 0))),
          },
          {
            ...axis,
            size: 58,
            space: 24,
            values: (_, splits) => splits.map((value) => String(+value.toPrecision(6)).replace("-", "−")),
          },
        ],
        series: [{}, { stroke: () => colour("--first"), width: 1.5, points: { show: false }, spanGaps: false }],
        hooks: {
          drawClear: [(plot) => shade(plot, gyros[index])],
          draw: [(plot) => markInvalid(plot, columns[index].valid)],
          setCursor: [() => read()],
        },
      },
      [[], []],
      canvas,
    );
    new ResizeObserver(() => plot.setSize({ width: canvas.clientWidth, height: plot.height })).observe(canvas);
    return plot;
  }

  /** Takes in which faults act: told are those that are not over. */
  function follow(half) {
    const acting = new Map(
      half.faults.filter(({ state }) => state === "active").map((fault) => [`${fault.id} ${fault.since_s}`, fault]),
    );
    for (const [key, fault] of faults) if (!acting.has(key)) fault.end_s ??= half.t_s - 0.5;
    for (const [key, fault] of acting) if (!faults.has(key)) faults.set(key, { ...fault, end_s: null });
    for (const [key, fault] of faults) if (fault.end_s !== null && fault.end_s < half.t_s - KEEP_S) faults.delete(key);
  }

  /** Where a fault acts on the gyro, or on all. */
  function shade(plot, gyro) {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    for (const fault of faults.values()) {
      if (fault.gyro && fault.gyro !== gyro) continue;
      const from = plot.valToPos(fault.since_s, "x", true);
      const to = Math.min(
        fault.end_s === null ? bbox.left + bbox.width : plot.valToPos(fault.end_s, "x", true),
        bbox.left + bbox.width,
      );
      ctx.fillStyle = ctx.strokeStyle = colour("--second");
      ctx.globalAlpha = 0.13;
      ctx.fillRect(from, bbox.top, to - from, bbox.height);
      ctx.globalAlpha = 0.8;
      ctx.fillRect(from, bbox.top, devicePixelRatio, bbox.height);
    }
    ctx.restore();
  }

  /** Where the gyro was not valid: shaded, and said on the trace. */
  function markInvalid(plot, valid) {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.fillStyle = colour("--bad");
    ctx.font = `600 ${12 * devicePixelRatio}px system-ui, "DejaVu Sans", sans-serif`;
    ctx.textBaseline = "top";
    ctx.textAlign = "left";
    for (let first = valid.indexOf(false); first >= 0; ) {
      const after = valid.indexOf(true, first);
      const last = after < 0 ? times.length - 1 : after - 1;
      const from = Math.max(plot.valToPos(times[first] - 0.5, "x", true), bbox.left);
      const to = plot.valToPos(times[last], "x", true);
      if (to > bbox.left) {
        ctx.globalAlpha = 0.16;
        ctx.fillRect(from, bbox.top, to - from, bbox.height);
        ctx.globalAlpha = 1;
        const room = ctx.measureText("not valid").width + 8 * devicePixelRatio;
        const at = Math.min(from + 4 * devicePixelRatio, bbox.left + bbox.width - room);
        ctx.fillText("not valid", Math.max(at, bbox.left), bbox.top + 4 * devicePixelRatio);
      }
      first = after < 0 ? -1 : valid.indexOf(false, after);
    }
    ctx.restore();
  }

  /** What stands beside each strip: the latest, or what the cursor points at. */
  function read() {
    strips.forEach(({ value, sub, plot }, index) => {
      const place = plot?.cursor.idx ?? times.length - 1;
      const column = columns[index][view.name];
      value.textContent = fixed(column[place] ?? NaN, view.decimals);
      const isValid = columns[index].valid[place] !== false;
      sub.classList.toggle("warn", !isValid);
      const unit = plot?.cursor.idx != null ? `at ${clock(times[place])}` : view.name === "counts" ? "count" : "arcsec";
      sub.textContent = isValid ? unit : "not valid";
    });
  }

  function draw() {
    if (isDrawing) return;
    isDrawing = true;
    requestAnimationFrame(() => {
      isDrawing = false;
      at("zero").hidden = view.name !== "accumulated";
      strips.forEach(({ plot }, index) => plot?.setData([times, columns[index][view.name]]));
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
    // What was not told is not drawn.
    if (last && times.length && half.half_second > last.half_second + 1) row((last.t_s + half.t_s) / 2, null);
    last = half;
    row(
      half.t_s,
      gyros.map((_, index) => {
        const counts = half.increments[index],
          truth = half.true_arcsec[index];
        // Summed by the unit: a run faster than real does not tell every half second.
        const accumulated = half.departure_arcsec[index] - zeros[index];
        const valid = ((half.gyro_flags >> validBits[index]) & 1) === 1;
        return { counts, truth, difference: counts - truth, accumulated, valid };
      }),
    );
  }

  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
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

/** A range with a margin, never narrower than `least`. */
function around(low, high, least) {
  if (!Number.isFinite(low) || !Number.isFinite(high)) return [-least, least];
  const half = Math.max((high - low) * 0.56, least / 2),
    middle = (high + low) / 2;
  return [middle - half, middle + half];
}
