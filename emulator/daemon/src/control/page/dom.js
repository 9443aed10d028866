// Elements, and questions to the unit.

export const at = (id) => document.getElementById(id);

/** An element with these properties and children; texts are texts, never markup. */
export function element(name, properties = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(properties)) {
    if (value === undefined || value === null) continue;
    if (key in made && key !== "list") made[key] = value;
    else made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

/** A definition list of readings, each text changed in place. */
export function readings(list) {
  const places = new Map();
  return (name, text) => {
    if (!places.has(name)) {
      const place = element("dd");
      list.append(element("div", {}, element("dt", {}, name), place));
      places.set(name, place);
    }
    const place = places.get(name);
    if (place.textContent !== text) place.textContent = text;
  };
}

/** A name that may be broken where its words end. */
export const breakable = (name) =>
  name.split(/(?<=[._-])(?=\p{L})/u).flatMap((word, index) => (index ? [element("wbr"), word] : [word]));

/** On-board time as h:mm:ss.s. */
export function clock(seconds, decimals = 1) {
  const hours = Math.floor(seconds / 3600),
    minutes = Math.floor(seconds / 60) % 60;
  const rest = (seconds % 60).toFixed(decimals).padStart(decimals ? 3 + decimals : 2, "0");
  return hours ? `${hours}:${String(minutes).padStart(2, "0")}:${rest}` : `${minutes}:${rest}`;
}

/** A number with these decimals, and a minus as wide as a plus. */
export const fixed = (value, decimals) => (Number.isFinite(value) ? value.toFixed(decimals).replace("-", "−") : "–");

const token = new URLSearchParams(location.search).get("token");

/** A path with the token that this page was opened with. */
export const path = (plain) => (token === null ? plain : `${plain}?token=${encodeURIComponent(token)}`);

/** Asks the unit; what it refuses is thrown in its own words. */
export async function ask(method, plain, body) {
  const headers = {};
  if (body !== undefined) headers["Content-Type"] = "application/json";
  if (token !== null) headers.Authorization = `Bearer ${token}`;
  const response = await fetch(plain, {
    method,
    headers,
    body: body === undefined ? undefined : JSON.stringify(body),
  }).catch(() => {
    throw new Error("the unit cannot be reached");
  });
  const text = await response.text();
  if (!response.ok) {
    let message = `${response.status} ${response.statusText}`;
    try {
      message = JSON.parse(text).error ?? message;
    } catch {
      /* not JSON */
    }
    throw Object.assign(new Error(message), { status: response.status });
  }
  return response.headers.get("content-type").startsWith("application/json") ? JSON.parse(text) : text;
}
