// Faults and commands: what the catalogue offers as forms, what is active as a list.

import { ask, at, breakable, clock, element, fixed } from "./dom.js";

/** A request whose error is shown in `place`; undefined if it was rejected. */
async function tried(place, question) {
  at(place).textContent = "";
  try {
    return await question();
  } catch (error) {
    at(place).textContent = error.message;
    return undefined;
  }
}

const range = (min, max, unit) => {
  const number = (value) => String(value).replace("-", "−");
  const span =
    min != null && max != null
      ? `${number(min)} to ${number(max)}`
      : min != null
        ? `from ${number(min)}`
        : max != null
          ? `to ${number(max)}`
          : "";
  return [span, unit].filter(Boolean).join(" ");
};

const label = (text, input, aside) =>
  element("label", {}, element("span", {}, text, aside ? element("small", {}, ` ${aside}`) : ""), input);

const options = (values) => values.map((value) => element("option", { value: String(value) }, String(value)));

/** An input for a number, a flag, a choice or a gyro; `read` gives its value as JSON has it. */
function field(spec, gyros, text = spec.name) {
  const common = { name: spec.name, title: spec.meaning };
  if (spec.form === "flag") {
    const input = element("select", common, ...options([true, false]));
    if (spec.default != null) input.value = String(spec.default);
    return { shown: label(text, input), read: () => input.value === "true" };
  }
  if (spec.form === "choice" || spec.form === "gyro") {
    const input = element("select", common, ...options(spec.form === "gyro" ? gyros : spec.choices));
    if (spec.default != null) input.value = spec.default;
    return { shown: label(text, input), read: () => input.value };
  }
  const input = element("input", {
    ...common,
    type: "number",
    step: spec.form === "whole" ? "1" : "any",
    min: spec.least,
    max: spec.greatest,
    required: spec.default == null,
    placeholder: spec.default ?? "",
  });
  return {
    shown: label(text, input, range(spec.least, spec.greatest, spec.unit)),
    read: () => (input.value === "" ? undefined : input.valueAsNumber),
  };
}

/** The panel that injects any fault of the catalogue; `open` are the kinds of links that there are. */
export function injector(catalogue, open, changed) {
  const { gyros, parameters, courses, faults } = catalogue;
  const group = (title, values) =>
    values.length
      ? [element("optgroup", { label: title }, ...values.map(([value, text]) => element("option", { value }, text)))]
      : [];
  const scoped = (scope) =>
    faults.filter((fault) => fault.scope === scope).map((fault) => [`f ${fault.fault}`, fault.title ?? fault.fault]);
  // Two parameters of one effect have one title.
  const titles = parameters.map((parameter) => parameter.title);
  const title = ({ title, parameter }) =>
    titles.filter((other) => other === title).length > 1
      ? `${title}: ${parameter.split(".").at(-1)}`
      : (title ?? parameter);
  const written = (perGyro) =>
    parameters
      .filter((parameter) => Boolean(parameter.per_gyro) === perGyro)
      .map((parameter) => [`p ${parameter.parameter}`, title(parameter)]);
  at("what").replaceChildren(
    ...group("Parameter of a gyro", written(true)),
    ...group("Parameter of the unit", written(false)),
    ...group("Fault of a gyro", scoped("gyro")),
    ...group("Fault of the unit", scoped("unit")),
    ...group("Fault of a link", scoped("link")),
  );
  let read = () => ({});

  function show() {
    const [kind, name] = [at("what").value[0], at("what").value.slice(2)];
    const place = at("what-fields");
    place.replaceChildren();
    const choice = (key, text, values) => {
      const input = element("select", { name: key }, ...values);
      place.append(label(text, input));
      return input;
    };
    if (kind === "p") {
      const parameter = parameters.find((known) => known.parameter === name);
      explain(parameter.meaning, name);
      const gyro = parameter.per_gyro
        ? choice("gyro", "Gyro", options(parameter.gyros?.length ? parameter.gyros : gyros))
        : null;
      const course = choice(
        "course",
        "Course",
        courses.map((known) => element("option", { value: known.course, title: known.meaning }, known.course)),
      );
      const numbers = element("div", { className: "fields inner" });
      place.append(numbers);
      let fields = [];
      const shape = () => {
        const chosen = courses.find((known) => known.course === course.value);
        fields = chosen.numbers.map((spec) => {
          const own = spec.name === chosen.course;
          const full = own
            ? {
                ...spec,
                form: parameter.form,
                unit: parameter.unit,
                default: null,
                least: parameter.least ?? spec.least,
                greatest: parameter.greatest ?? spec.greatest,
              }
            : spec;
          return [spec.name, field(full, gyros, own ? "value" : spec.name)];
        });
        numbers.replaceChildren(...fields.map(([, made]) => made.shown));
      };
      course.addEventListener("change", shape);
      shape();
      read = () => ({ gyro: gyro?.value, parameter: name, course: values(fields) });
    } else {
      const fault = faults.find((known) => known.fault === name);
      explain(fault.meaning, name);
      const gyro = fault.scope === "gyro" ? choice("gyro", "Gyro", options(gyros)) : null;
      const link =
        fault.scope === "link"
          ? choice(
              "link",
              "Link",
              [
                ...(open.length > 1 ? [element("option", { value: "" }, "every link that can")] : []),
                ...open.map((kind) =>
                  element(
                    "option",
                    { value: kind, disabled: fault.links[kind] !== null },
                    fault.links[kind] === null ? kind : `${kind}: ${fault.links[kind]}`,
                  ),
                ),
              ],
            )
          : null;
      const fields = fault.numbers.map((spec) => [spec.name, field(spec, gyros)]);
      place.append(...fields.map(([, made]) => made.shown));
      read = () => ({ fault: name, gyro: gyro?.value, link: link?.value || undefined, ...values(fields) });
    }
  }

  const explain = (meaning, name) =>
    at("what-meaning").replaceChildren(...(meaning ? [`${meaning} `] : []), element("code", {}, ...breakable(name)));
  const values = (fields) => Object.fromEntries(fields.map(([name, made]) => [name, made.read()]));
  at("what").addEventListener("change", show);
  show();
  at("inject-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const form = event.target,
      fault = read();
    for (const name of ["for_s", "at_s", "release_s", "times", "probability"]) {
      if (form.elements[name].value !== "") fault[name] = form.elements[name].valueAsNumber;
    }
    for (const name of ["when", "id"]) {
      if (form.elements[name].value.trim() !== "") fault[name] = form.elements[name].value.trim();
    }
    at("injected").textContent = "";
    const injected = await tried("inject-error", () => ask("POST", "/api/faults", fault));
    if (injected) {
      at("injected").textContent = `${injected.id ?? "fault"}: ${injected.state ?? "taken in"}`;
      changed();
    }
  });
}

/** The list of faults that are armed or active; gives what takes a new state in. */
export function faultList(catalogue, changed) {
  const titles = new Map([
    ...catalogue.parameters.map((known) => [known.parameter, known.title]),
    ...catalogue.faults.map((known) => [known.fault, known.title]),
  ]);
  let shown = null;
  at("clear-all").addEventListener("click", async () => {
    if (await tried("clear-error", () => ask("DELETE", "/api/faults"))) changed();
  });
  return (faults) => {
    const now = faults.filter((fault) => fault.state !== "over");
    const said = JSON.stringify(now);
    // Built anew only when something changed, so that a button keeps the focus.
    if (said === shown) return;
    shown = said;
    at("clear-all").hidden = now.length < 2;
    at("faults").replaceChildren(
      ...now.map((fault) => {
        const button = element("button", { type: "button", ariaLabel: `Clear ${fault.id}` }, "Clear");
        button.addEventListener("click", async () => {
          if (await tried("clear-error", () => ask("DELETE", `/api/faults/${encodeURIComponent(fault.id)}`))) changed();
        });
        const times = [
          Number.isFinite(fault.since_s) ? `since ${clock(fault.since_s)}` : "",
          Number.isFinite(fault.ends_s) ? `until ${clock(fault.ends_s)}` : "",
        ]
          .filter(Boolean)
          .join(", ");
        return element(
          "li",
          { className: fault.state },
          element("span", { className: "lamp" }, fault.state),
          element(
            "span",
            { className: "said" },
            element(
              "b",
              {},
              [fault.gyro ?? fault.link, titles.get(fault.what) ?? fault.what].filter(Boolean).join(" "),
            ),
            element(
              "small",
              {},
              ...breakable(fault.what ?? ""),
              " ",
              element("span", {}, [fault.id, times].filter(Boolean).join(", ")),
            ),
          ),
          button,
        );
      }),
    );
    if (!now.length)
      at("faults").append(element("li", { className: "none" }, "None: the unit does what its configuration says."));
  };
}

/** Number of events of a watch shown. */
const WATCH_EVENTS = 100;
/** Times of a link from this one on are Unix time. */
const UNIX_S = 1e8;

/** The panel with the events of `geu watch`, the latest first. */
export function watchList() {
  const known = new Map();
  const time = (t) => (t < UNIX_S ? clock(t) : new Date(t * 1000).toISOString().slice(0, 19).replace("T", " "));
  const row = (event) =>
    element(
      "tr",
      { className: event.event },
      ...[
        element("time", { title: `${event.t_s} s` }, time(event.t_s)),
        event.event,
        event.code,
        event.gyros.join(" "),
        fixed(event.statistic, 1),
        fixed(event.threshold, 1),
      ].map((cell) => element("td", {}, cell)),
    );
  return {
    clear: () => known.clear(),
    take(events) {
      events.forEach((event) => known.set(event.number, event));
      const latest = [...known.values()].sort((a, b) => b.number - a.number).slice(0, WATCH_EVENTS);
      known.forEach((event) => event.number < latest.at(-1).number && known.delete(event.number));
      const none = "None: `geu watch` on a link of this unit reports changes of its gyros here.";
      at("watch-rows").replaceChildren(
        ...(latest.length ? latest.map(row) : [element("tr", {}, element("td", { colSpan: 6, className: "none" }, none))]),
      );
    },
  };
}

/** The panel that sends commands. */
export function commander(commands) {
  let fields = [];
  at("command-name").replaceChildren(...commands.map(({ name }) => element("option", { value: name }, name)));
  const chosen = () => commands.find((command) => command.name === at("command-name").value);
  const show = () => {
    at("command-meaning").textContent = chosen().meaning ?? "";
    fields = chosen().arguments.map((argument) => {
      const input = argument.choices?.length
        ? element(
            "select",
            { name: argument.name },
            ...argument.choices.map(({ value, name }) => element("option", { value }, `${value} ${name}`)),
          )
        : element("input", {
            name: argument.name,
            type: "number",
            step: "1",
            required: true,
            min: argument.least,
            max: argument.greatest,
            title: argument.meaning,
          });
      return {
        input,
        shown: label(argument.name, input, argument.choices?.length ? "" : range(argument.least, argument.greatest)),
      };
    });
    at("command-fields").replaceChildren(...fields.map((made) => made.shown));
  };
  at("command-name").addEventListener("change", show);
  show();
  at("command-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const command = { name: chosen().name, arguments: fields.map(({ input }) => Number(input.value)) };
    at("replied").textContent = "";
    const reply = await tried("command-error", () => ask("POST", "/api/commands", command));
    if (!reply) return;
    const values = Object.entries(reply.values ?? {}).map(([name, value]) => `${name} ${value}`);
    const polled = reply.polled
      ? [`sequence ${reply.polled.sequence}, increments ${reply.polled.increments.join(" ")}`]
      : [];
    at("replied").textContent = [`${command.name}: ${reply.outcome}`, ...values, ...polled].join("  ");
  });
}
