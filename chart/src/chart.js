// Zoom, pan and values under the pointer for the charts of a page. Data keep their own coordinates below one transform.
"use strict";
var geuChart = (() => {
  const DRAG_PX = 4;
  const TICK_PX = { x: 85, y: 32 };
  const charts = new Set();
  const numbers = (text) => text.trim().split(/\s+/).map(Number);
  const within = (value, [low, high]) => Math.min(Math.max(value, low), high);
  const shown = (value) => String(+value.toPrecision(6)).replace("-", "−");
  const tip = document.createElement("output");
  tip.className = "chart-tip";
  tip.hidden = true;

  function ticks([low, high], count, minStep) {
    const rough = Math.max((high - low) / Math.max(count, 1), minStep, Number.MIN_VALUE);
    const decade = 10 ** Math.floor(Math.log10(rough));
    const step = decade * ([1, 2, 5].find((factor) => factor * decade >= rough) ?? 10);
    const decimals = Math.min(Math.max(Math.ceil(-Math.log10(step) - 1e-9), 0), 12);
    const all = [];
    for (let n = Math.ceil(low / step); n * step <= high && all.length < 60; n += 1)
      all.push([n * step, (n * step).toFixed(decimals).replace(/^-/, "−")]);
    return all;
  }

  function showTooltip(event, lines) {
    tip.hidden = lines.length === 0;
    if (tip.hidden) return;
    document.body.append(tip);
    tip.replaceChildren(...lines.flatMap((line) => [line, document.createElement("br")]).slice(0, -1));
    const box = tip.getBoundingClientRect();
    const beside = event.clientX + 14 + box.width < window.innerWidth ? event.clientX + 14 : event.clientX - 14 - box.width;
    tip.style.left = `${Math.max(beside, 4)}px`;
    tip.style.top = `${within(event.clientY + 14, [4, Math.max(window.innerHeight - box.height - 4, 4)])}px`;
  }

  /** `formatX` writes values of x; `onCursor` hears at which x the pointer is, or null; `isLive`: the ticks are the script's. */
  function attach(svg, { formatX = shown, onCursor = () => {}, isLive = false } = {}) {
    let [left, top, right, bottom] = numbers(svg.dataset.frame);
    const home = { x: numbers(svg.dataset.x), y: numbers(svg.dataset.y) };
    const part = (name) => svg.querySelector(name);
    const [data, marks, inside] = [part(".data"), part(".marks"), part(".inside")];
    const axes = { x: part(".x.axis"), y: part(".y.axis") };
    const original = { x: [...axes.x.childNodes], y: [...axes.y.childNodes] };
    const series = new Map();
    let view = null,
      start = null;
    const now = () => view ?? home;
    const scale = () => {
      const { x, y } = now();
      return [(right - left) / (x[1] - x[0]), (bottom - top) / (y[1] - y[0])];
    };
    const xPx = (x) => left + (x - now().x[0]) * scale()[0];
    const yPx = (y) => bottom - (y - now().y[0]) * scale()[1];
    const xAt = (px) => now().x[0] + (px - left) / scale()[0];
    const yAt = (px) => now().y[0] + (bottom - px) / scale()[1];
    const make = (name, attributes, parent) => {
      const made = document.createElementNS(svg.namespaceURI, name);
      for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
      parent.append(made);
      return made;
    };
    const chosen = make("rect", { class: "chosen", visibility: "hidden" }, inside);
    const cursor = make("line", { class: "cursor", visibility: "hidden" }, inside);

    function drawAxis(name) {
      const isX = name === "x";
      if (!isLive && (!view || (!isX && svg.dataset.zoom === "x"))) return axes[name].replaceChildren(...original[name]);
      axes[name].replaceChildren();
      const length = isX ? right - left : bottom - top;
      for (const [at, text] of ticks(now()[name], length / TICK_PX[name], isX ? Number(svg.dataset.step) : 0)) {
        const px = isX ? xPx(at) : yPx(at);
        const ends = isX ? { x1: px, x2: px, y1: top, y2: bottom } : { x1: left, x2: right, y1: px, y2: px };
        make("line", { class: at === 0 ? "zero" : "rule", ...ends }, axes[name]);
        const place = isX ? { x: px, y: bottom + 14, "text-anchor": "middle" } : { x: left - 5, y: px + 4, "text-anchor": "end" };
        make("text", place, axes[name]).textContent = isX ? (formatX === shown ? text : formatX(at)) : text;
      }
    }

    function draw() {
      const [width, height] = scale();
      const { x, y } = now();
      const matrix = [width, 0, 0, -height, left - x[0] * width, bottom + y[0] * height];
      data.setAttribute("transform", `matrix(${matrix.join(" ")})`);
      for (const mark of marks.children) {
        const [atX, atY] = numbers(mark.dataset.at);
        mark.setAttribute("transform", `translate(${xPx(atX)} ${yPx(atY)})`);
      }
      drawAxis("x");
      drawAxis("y");
      svg.classList.toggle("zoomed", view !== null);
    }

    /** Shows a part of the whole; of charts in one group, the same part of x. */
    function zoom(x, y, isFirst = true) {
      const fitted = (range, whole) => {
        const length = Math.min(range[1] - range[0], whole[1] - whole[0]);
        const low = within(range[0], [whole[0], whole[1] - length]);
        return [low, low + length];
      };
      const next = { x: fitted(x, home.x), y: svg.dataset.zoom === "x" ? home.y : fitted(y, home.y) };
      if (!(next.x[1] - next.x[0] > (home.x[1] - home.x[0]) * 1e-6) || !(next.y[1] > next.y[0])) return;
      const isWhole = (name) => next[name][1] - next[name][0] >= (home[name][1] - home[name][0]) * (1 - 1e-9);
      view = isWhole("x") && isWhole("y") ? null : next;
      draw();
      if (isFirst) others((chart) => chart.zoomX(next.x));
    }
    const others = (act) => {
      for (const chart of charts) if (chart !== self && svg.dataset.group && chart.group === svg.dataset.group) act(chart);
    };
    const reset = () => zoom(home.x, home.y);
    function about(factor, atX, atY) {
      const range = ([low, high], at) => [at - (at - low) * factor, at + (high - at) * factor];
      zoom(range(now().x, atX), range(now().y, atY));
    }
    function move(shareX, shareY) {
      const moved = ([low, high], share) => [low + share * (high - low), high + share * (high - low)];
      zoom(moved(now().x, shareX), moved(now().y, shareY));
    }

    /** Position of the pointer in the coordinates of the chart; undefined outside of the frame. */
    function place(event) {
      const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
      const isInside = point.x >= left && point.x <= right && point.y >= top && point.y <= bottom;
      return { x: within(point.x, [left, right]), y: within(point.y, [top, bottom]), isInside };
    }

    function pointsOf(path) {
      if (!series.has(path)) {
        const found = path.getAttribute("d").matchAll(/[ML](\S+) ([^ML]+)/g);
        series.set(path, [...found].map((point) => [Number(point[1]), Number(point[2])]));
      }
      return series.get(path);
    }
    function nearest(points, x) {
      let [low, high] = [0, points.length];
      while (low < high) {
        const middle = (low + high) >> 1;
        if (points[middle][0] < x) low = middle + 1;
        else high = middle;
      }
      const [before, after] = [points[low - 1], points[low]];
      if (!before || !after) return before ?? after;
      return x - before[0] < after[0] - x ? before : after;
    }
    function point(x) {
      for (const [name, value] of Object.entries({ x1: xPx(x), x2: xPx(x), y1: top, y2: bottom })) cursor.setAttribute(name, value);
      cursor.setAttribute("visibility", x === null ? "hidden" : "visible");
      onCursor(x);
    }
    function read(event) {
      const { x: px, isInside } = place(event);
      const titled = event.target.closest?.("[data-title]");
      const lines = titled && svg.contains(titled) ? [titled.dataset.title] : [];
      const paths = [...data.querySelectorAll("[data-series]")];
      const x = isInside && (isLive || paths.length) ? xAt(px) : null;
      point(x);
      others((chart) => chart.point(x));
      if (x !== null && !isLive) {
        lines.unshift(`${formatX(x)} ${svg.dataset.xUnit ?? ""}`);
        for (const path of paths) {
          const found = nearest(pointsOf(path), x);
          // Nothing is read where a gap is shown.
          if (found && Math.abs(xPx(found[0]) - px) < 8)
            lines.push(`${path.dataset.series}: ${shown(found[1])} ${svg.dataset.yUnit ?? ""}`);
        }
      }
      showTooltip(event, lines);
    }

    svg.addEventListener("pointerdown", (event) => {
      const at = place(event);
      if (event.button !== 0 || !at.isInside) return;
      start = { ...at, view: now(), isPan: event.shiftKey || event.pointerType === "touch", hasMoved: false };
      svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointermove", (event) => {
      if (!start) return read(event);
      const at = place(event);
      start.hasMoved ||= Math.hypot(at.x - start.x, at.y - start.y) > DRAG_PX;
      if (!start.hasMoved) return;
      if (start.isPan) {
        const [dx, dy] = [(start.x - at.x) / scale()[0], (at.y - start.y) / scale()[1]];
        return zoom(start.view.x.map((x) => x + dx), start.view.y.map((y) => y + dy));
      }
      // A wide and low selection selects x with all of y, a high and narrow one the reverse.
      const [wide, high] = [Math.abs(at.x - start.x), Math.abs(at.y - start.y)];
      start.isWholeY = svg.dataset.zoom === "x" || high < 12;
      start.isWholeX = svg.dataset.zoom !== "x" && wide < 12 && high >= 12;
      const box = {
        x: start.isWholeX ? left : Math.min(at.x, start.x),
        y: start.isWholeY ? top : Math.min(at.y, start.y),
        width: start.isWholeX ? right - left : wide,
        height: start.isWholeY ? bottom - top : high,
        visibility: "visible",
      };
      for (const [name, value] of Object.entries(box)) chosen.setAttribute(name, value);
    });
    function end(event) {
      const from = start;
      start = null;
      chosen.setAttribute("visibility", "hidden");
      if (event.type !== "pointerup" || !from?.hasMoved || from.isPan) return;
      const at = place(event);
      const sorted = (one, other) => [Math.min(one, other), Math.max(one, other)];
      zoom(
        from.isWholeX ? now().x : sorted(xAt(at.x), xAt(from.x)),
        from.isWholeY ? now().y : sorted(yAt(at.y), yAt(from.y)),
      );
    }
    svg.addEventListener("pointerup", end);
    svg.addEventListener("pointercancel", end);
    svg.addEventListener("pointerleave", (event) => {
      point(null);
      others((chart) => chart.point(null));
      showTooltip(event, []);
    });
    svg.addEventListener("dblclick", (event) => {
      const at = place(event);
      if (view) reset();
      else if (at.isInside) about(0.5, xAt(at.x), yAt(at.y));
    });
    svg.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey && !event.metaKey) return;
        event.preventDefault();
        const at = place(event);
        about(Math.exp(within(event.deltaY, [-100, 100]) * 0.004), xAt(at.x), yAt(at.y));
      },
      { passive: false },
    );
    svg.addEventListener("keydown", (event) => {
      const middle = ([low, high]) => (low + high) / 2;
      const acts = {
        "+": () => about(0.5, middle(now().x), middle(now().y)),
        "-": () => about(2, middle(now().x), middle(now().y)),
        ArrowLeft: () => move(-0.2, 0),
        ArrowRight: () => move(0.2, 0),
        ArrowUp: () => move(0, 0.2),
        ArrowDown: () => move(0, -0.2),
        Escape: reset,
        0: reset,
      };
      const act = acts[event.key === "=" ? "+" : event.key];
      if (!act || (!view && event.key.startsWith("Arrow")) || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      act();
    });
    for (const title of svg.querySelectorAll("title")) {
      title.parentNode.dataset.title = title.textContent;
      title.remove();
    }
    svg.setAttribute("tabindex", "0");

    const self = {
      group: svg.dataset.group,
      zoomX: (x) => zoom(x, now().y, false),
      point,
      make,
      /** Shows these ranges wherever the reader has not chosen others. */
      show(x, y) {
        [home.x, home.y] = [x, y];
        draw();
      },
      isZoomed: () => view !== null,
      reset,
      /** Another width, pixels; the margins stay. */
      resize(width) {
        const [, , oldWidth, height] = numbers(svg.getAttribute("viewBox"));
        right += width - oldWidth;
        svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
        for (const frame of svg.querySelectorAll(".frame, .inside")) frame.setAttribute("width", Math.max(right - left, 1));
        inside.setAttribute("viewBox", `${left} ${top} ${Math.max(right - left, 1)} ${bottom - top}`);
        draw();
      },
    };
    charts.add(self);
    if (isLive) draw();
    return self;
  }

  document.querySelectorAll("svg.chart").forEach((svg) => attach(svg));
  return attach;
})();
