// The last frame, field by field, with the layout that the unit publishes.

import { at, breakable, element } from "./dom.js";

const TABS = [
  ["serial", "Serial"],
  ["can", "CAN"],
];

/** Shows samples as the links carry them. */
export function wire(layout) {
  let shown = layout.serial.length ? "serial" : "can",
    last = null;
  const links = TABS.filter(([name]) => layout[name].length);
  const tabs = links.map(([name, title]) => {
    const tab = element("button", { type: "button", role: "tab", id: `tab-${name}` }, title);
    tab.setAttribute("aria-controls", "frames");
    tab.addEventListener("click", () => choose(name));
    tab.addEventListener("keydown", (event) => {
      if (event.key !== "ArrowLeft" && event.key !== "ArrowRight") return;
      choose((links.find(([other]) => other !== shown) ?? links[0])[0]);
      at(`tab-${shown}`).focus();
    });
    return tab;
  });
  at("tabs").append(...tabs);

  // Rows are permanent; only their bytes and values change.
  const parts = { serial: [{ name: "DATA", fields: layout.serial }], can: layout.can };
  let rows = [];
  function choose(name) {
    shown = name;
    tabs.forEach((tab, index) => {
      tab.setAttribute("aria-selected", String(links[index][0] === name));
      tab.tabIndex = links[index][0] === name ? 0 : -1;
    });
    at("frames").setAttribute("aria-labelledby", `tab-${name}`);
    rows = parts[name].map((part) => {
      const title = element("code", { className: "frame" });
      const cells = part.fields.map((field) => ({
        field,
        bytes: element("td", { className: "bytes" }),
        value: element("td"),
      }));
      const body = element(
        "tbody",
        {},
        ...cells.map(({ field, bytes, value }) =>
          element(
            "tr",
            { title: field.meaning },
            element("td", {}, String(field.at)),
            bytes,
            element("th", { scope: "row" }, field.name),
            value,
          ),
        ),
      );
      const head = element(
        "thead",
        {},
        element("tr", {}, ...["byte", "hex", "field", "value"].map((text) => element("th", { scope: "col" }, text))),
      );
      return {
        part,
        title,
        cells,
        shown: element(
          "div",
          { className: "part" },
          element("h3", {}, part.name),
          title,
          element("div", { className: "wide" }, element("table", {}, head, body)),
        ),
      };
    });
    at("frames").replaceChildren(...rows.map((row) => row.shown));
    fill();
  }

  function fill() {
    if (!last) return;
    rows.forEach(({ title, cells }, index) => {
      const line = shown === "serial" ? last.serial : (last.can[index] ?? "");
      const [id, data] = line.includes("#") ? line.split("#") : ["", line];
      const bytes = data.match(/../g) ?? [];
      title.textContent = [id, bytes.join(" ")].filter(Boolean).join("  ");
      for (const { field, bytes: place, value } of cells) {
        const own = bytes.slice(field.at, field.at + field.length);
        place.textContent = own.join(" ");
        const digits = field.little_endian ? own.toReversed() : own;
        const said = own.length === field.length ? meaning(field, digits.join("")) : "–";
        if (value.textContent !== said) value.replaceChildren(...breakable(said));
      }
    });
  }

  choose(shown);
  return {
    take(half) {
      last = half.wire;
      fill();
    },
  };
}

/** The number that these digits say, with unit and named bits. */
function meaning(field, hex) {
  let number = parseInt(hex, 16);
  if (field.form === "digits") return hex;
  if (field.form === "flags") {
    const names = field.bits.filter(({ bit }) => (number >> bit) & 1).map(({ name }) => name);
    return names.join(", ") || "none";
  }
  if (field.signed && number >= 2 ** (8 * field.length - 1)) number -= 2 ** (8 * field.length);
  const decimals = Math.min(12, Math.max(0, -Math.floor(Math.log10(Math.abs(field.scale)))));
  return `${(number * field.scale + (field.offset ?? 0)).toFixed(decimals).replace("-", "−")} ${field.unit.replace("degC", "°C")}`.trim();
}
