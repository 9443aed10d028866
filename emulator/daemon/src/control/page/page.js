// The bench page: follows the unit's events, and says so when they stop.

import { charts } from "./charts.js";
import { ask, at, breakable, clock, element, fixed, path, readings } from "./dom.js";
import { commander, faultList, injector, watchList } from "./panels.js";
import { wire } from "./wire.js";

/** Time without a sample after which the unit is reported as silent. */
const SILENCE_MS = 3000;
const AGAIN_MS = 1000;
const STATUS_MS = 2000;
const HAPPENINGS = 500;

/** Flags that are no alarm and yet not the ordinary state. */
const TONES = { self_test: "doubt", polled: "doubt" };
/** Flags whose absence is an alarm. */
const ALARM_WHEN_OFF = /_valid$|^heater_in_band$|^motors_synchronous$|^clock_locked$/;

const show = readings(at("readings"));
const showLateness = readings(at("lateness"));
const happened = [];
let isOpen = false,
  heard = 0;

function trouble(text) {
  at("trouble").textContent = text;
  at("trouble").hidden = text === "";
}

function state(name, text) {
  at("connection").className = `pill ${name}`;
  if (at("connection").textContent !== text) at("connection").textContent = text;
}

function lamps(layout) {
  const bits = (name) => layout.serial.find((field) => field.name === name)?.bits ?? [];
  const made = ["gyro_flags", "unit_flags"].flatMap((name) =>
    bits(name).map(({ bit, name: said, meaning }) => {
      const lamp = element("li", { title: meaning }, said.replaceAll("_", " "));
      at("lamps").append(lamp);
      return { name, bit, said, lamp };
    }),
  );
  return (half) =>
    made.forEach(({ name, bit, said, lamp }) => {
      const isOn = ((half[name] >> bit) & 1) === 1;
      const tone = isOn ? (TONES[said] ?? (said.endsWith("_saturated") ? "bad" : "good")) : ALARM_WHEN_OFF.test(said) ? "bad" : "";
      const text = said.replaceAll("_", " ") + (!isOn && tone ? ": no" : "");
      if (lamp.textContent !== text) lamp.textContent = text;
      lamp.className = `${isOn ? "on " : ""}${tone}`;
    });
}

function links(half) {
  const rows = half.links.map((link) => [
    link.name,
    link.clients,
    link.sent,
    link.unread,
    link.dropped,
    link.replies,
    link.unread > 0 ? `${link.unread} samples were not sent, because no client was connected` : "",
  ]);
  const said = JSON.stringify(rows);
  if (at("link-rows").dataset.said === said) return;
  at("link-rows").dataset.said = said;
  at("link-rows").replaceChildren(
    ...rows.map((row) =>
      element(
        "tr",
        { title: row[6] },
        ...row
          .slice(0, 6)
          .map((cell, index) =>
            element(index ? "td" : "th", index === 4 && cell > 0 ? { className: "warn" } : {}, String(cell)),
          ),
      ),
    ),
  );
}

function numbers(half) {
  const unit = (value, decimals, name) => `${fixed(value, decimals)} ${name}`;
  show("on-board time", clock(half.t_s));
  show("sequence", String(half.sequence));
  show("clock count", String(half.clock_count));
  show("electronics", unit(half.electronics_c, 2, "°C"));
  show("sensor", unit(half.sensor_c, 2, "°C"));
  show("mode", half.cyclic === false ? "polled" : "cyclic");
  const degrees = (value) => (value == null ? "–" : `${fixed(value, 2)}°`);
  const [x, y, z] = half.rate_arcsec_s ?? [];
  show("true rate x, y, z", `${fixed(x, 1)}  ${fixed(y, 1)}  ${fixed(z, 1)} ″/s`);
  show("solar aspect angle θ", degrees(half.theta_deg));
  show("angle about the sun vector ψ", degrees(half.psi_deg));
  const { count, p50_us: p50, p99_us: p99, max_us: max } = half.lateness;
  const time = (us) => (us >= 1000 ? unit(us / 1000, 2, "ms") : unit(us, 0, "µs"));
  showLateness("lateness p50", count ? time(p50) : "–");
  showLateness("p99", count ? time(p99) : "–");
  showLateness("max", count ? time(max) : "–");
  showLateness("late", String(half.late));
  showLateness("missed", String(half.missed));
}

/** A recording that ended before the run does. */
function recorded({ recording }) {
  const hasEnded = recording?.state === "ended";
  at("recording").hidden = !hasEnded;
  if (hasEnded) {
    const { directory, half_second: count, reason } = recording;
    const text = `The recording in ${directory} ended at sample ${count}: ${reason}. The unit continues.`;
    // Once, for who has it read aloud.
    if (at("recording").textContent !== text) at("recording").textContent = text;
  }
}

/** Adds lines to the timeline, except known ones. */
function take(lines) {
  const known = new Set(happened);
  for (const line of lines.filter((line) => line !== "" && !known.has(line))) {
    happened.push(line);
    const { t_s: t, kind, text } = JSON.parse(line);
    at("happenings").prepend(
      element(
        "li",
        { className: kind },
        element("time", {}, clock(t)),
        element("span", { className: "kind" }, kind),
        element("span", {}, ...breakable(text)),
      ),
    );
  }
  while (happened.length > HAPPENINGS) {
    happened.shift();
    at("happenings").lastChild.remove();
  }
}

function start([catalogue, layout, status]) {
  const flagBits = layout.serial.find((field) => field.name === "gyro_flags")?.bits ?? [];
  const validBits = catalogue.gyros.map(
    (gyro, index) => flagBits.find(({ name }) => name === `${gyro.toLowerCase()}_valid`)?.bit ?? index,
  );
  const gyros = charts(catalogue.gyros, validBits),
    frames = wire(layout),
    flags = lamps(layout);
  const showFaults = faultList(catalogue, refresh);
  async function refresh() {
    showFaults(await ask("GET", "/api/faults").catch(() => []));
  }
  const watch = watchList();
  injector(catalogue, [...new Set((status.links ?? []).map(({ kind }) => kind))], refresh);
  if (catalogue.commands.length) commander(catalogue.commands);
  else at("command").remove();
  if (status.links) links(status);
  recorded(status);
  at("download").href = path("/api/timeline");
  at("document").href = path("/api/openapi.json");

  // Samples received during the request of the history; null once it is drawn.
  let waiting = [],
    latest = 0,
    refill = 0;
  async function fill() {
    waiting ??= [];
    const history = await ask("GET", "/api/history").catch(() => []);
    if (history.length) gyros.fill(history);
    const end_s = history.at(-1)?.t_s ?? -1;
    waiting?.filter((half) => half.t_s > end_s).forEach(gyros.take);
    waiting = null;
    refill = 0;
  }
  /** A run faster than real time does not publish every sample: the others are fetched, once a second. */
  function fetchSkipped(half) {
    if (half.half_second > latest + 1 && !waiting) refill ||= setTimeout(fill, AGAIN_MS);
    latest = half.half_second;
  }

  function follow() {
    const source = new EventSource(path("/api/events"));
    source.addEventListener("open", async () => {
      isOpen = true;
      heard = performance.now();
      trouble("");
      refresh();
      fill();
      // Another run counts its events from 1.
      watch.clear();
      ask("GET", "/api/watch").then(watch.take, () => {});
      take((await ask("GET", "/api/timeline").catch(() => "")).split("\n"));
    });
    source.addEventListener("error", () => {
      isOpen = false;
      trouble("The connection to the unit is lost; trying again. Values shown are the last received.");
      // Rejected rather than interrupted: the browser does not retry by itself.
      if (source.readyState === EventSource.CLOSED) setTimeout(follow, AGAIN_MS);
    });
    source.addEventListener("half-second", (event) => {
      const half = JSON.parse(event.data);
      heard = performance.now();
      fetchSkipped(half);
      if (waiting) waiting.push(half);
      else gyros.take(half);
      frames.take(half);
      flags(half);
      numbers(half);
      links(half);
      showFaults(half.faults);
    });
    source.addEventListener("timeline", (event) => take([event.data]));
    source.addEventListener("watch", (event) => watch.take([JSON.parse(event.data)]));
  }
  follow();
  setInterval(() => {
    const silence = performance.now() - heard;
    if (!isOpen) state("lost", "reconnecting");
    else if (silence > SILENCE_MS) state("silent", `silent for ${Math.round(silence / 1000)} s`);
    else state("live", "live");
  }, 250);
  setInterval(() => ask("GET", "/api/status").then(recorded, () => {}), STATUS_MS);
}

/** Until the unit answers once, there is nothing to show. */
async function begin() {
  let answers;
  try {
    answers = await Promise.all(["/api/catalogue", "/api/layout", "/api/status"].map((plain) => ask("GET", plain)));
  } catch (error) {
    state("lost", "not connected");
    trouble(
      error.status === 401
        ? "This unit wants a token: open the page as /?token=TOKEN."
        : `${error.message}; trying again.`,
    );
    if (error.status !== 401) setTimeout(begin, AGAIN_MS);
    return;
  }
  trouble("");
  start(answers);
}
begin();
