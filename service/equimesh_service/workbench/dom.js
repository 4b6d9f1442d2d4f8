// Elements of the document, made without markup in strings: the policy of the page allows no inline script or style.

const SVG = "http://www.w3.org/2000/svg";
const SVG_NAMES = new Set(["svg", "path", "line", "circle", "rect", "g", "text", "polyline", "polygon", "title"]);
let made = 0;

/**
 * An element with attributes and children.
 *
 * An attribute `onclick` (any name that begins with "on") is a listener.  `true` sets an attribute without a value,
 * and `false`, `null` or `undefined` leaves it out.  `style` is an object.  Children are nodes or text; lists are
 * flattened, and `null` or `false` are left out.
 *
 * @param {string} tag
 * @param {object} [attributes]
 * @param {...(Node|string|number|null|false|Array)} children
 */
export function element(tag, attributes = {}, ...children) {
  const node = SVG_NAMES.has(tag) ? document.createElementNS(SVG, tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes ?? {})) {
    if (value === false || value === null || value === undefined) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (name === "style") Object.assign(node.style, value);
    else node.setAttribute(name, value === true ? "" : String(value));
  }
  node.append(...children.flat(3).filter((child) => child !== null && child !== undefined && child !== false));
  return node;
}

/** An id that no other element of the page has. */
export function freshId(word) {
  made += 1;
  return `${word}-${made}`;
}

/**
 * A control with its label, and a place for what is wrong with it.
 *
 * With `app` and `pointer`, the faults of the last answer whose JSON pointer begins with `pointer` (such as
 * "/grid/n_xi") are shown under the control, which is then marked as invalid.  `help` is a sentence under the label.
 *
 * @param {string} label
 * @param {HTMLElement} control an input, select or textarea
 * @param {{app?: object, pointer?: string, help?: string, inline?: boolean}} [options]
 */
export function field(label, control, { app, pointer, help, inline = false } = {}) {
  control.id ||= freshId("field");
  const fault = element("p", { class: "fault", id: freshId("fault") });
  const described = [fault.id];
  let hint = null;
  if (help) {
    hint = element("p", { class: "hint", id: freshId("hint") }, help);
    described.unshift(hint.id);
  }
  control.setAttribute("aria-describedby", described.join(" "));
  if (app && pointer) {
    app.on("problem", (problem) => {
      const mine = (problem?.errors ?? []).filter((each) => `${each.pointer ?? ""}/`.startsWith(`${pointer}/`));
      fault.textContent = mine.map((each) => each.message).join("; ");
      control.toggleAttribute("aria-invalid", false);
      if (mine.length) control.setAttribute("aria-invalid", "true");
    });
  }
  return element(
    "div",
    { class: inline ? "field inline" : "field" },
    element("label", { for: control.id }, label),
    control,
    hint,
    fault,
  );
}

/**
 * A select of choices; `onchange` is called with the value that was chosen.
 *
 * @param {{value: string, text: string}[]} choices
 * @param {string} chosen
 * @param {(value: string) => void} onchange
 */
export function select(choices, chosen, onchange) {
  const node = element("select", { onchange: () => onchange(node.value) });
  node.append(...choices.map(({ value, text }) => element("option", { value, selected: value === chosen }, text)));
  return node;
}
