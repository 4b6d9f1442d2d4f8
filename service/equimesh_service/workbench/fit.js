// A function that was written for one domain, moved to another one.

/**
 * An expression of x and y on another domain: the boxes of both domains are put on each other.
 *
 * @param {string} expression
 * @param {[number, number][]} from the box of the domain that it was written for, in x and in y
 * @param {[number, number][]} to the box of the other domain
 */
export function fitted(expression, from, to) {
  return ["x", "y"].reduce((text, name, axis) => {
    const moved = movedName(name, from[axis], to[axis]);
    // Not a part of a longer name; a number before it is a factor.
    return moved === name ? text : text.replaceAll(new RegExp(`(?<![A-Za-z_.])${name}(?!\\w)`, "g"), moved);
  }, expression);
}

function movedName(name, [first, last], [start, end]) {
  const factor = rounded((last - first) / (end - start));
  const shift = rounded(first - factor * start);
  if (factor === 1 && shift === 0) return name;
  const product = factor === 1 ? name : `${factor}*${name}`;
  return shift === 0 ? `(${product})` : `(${product} ${shift < 0 ? "-" : "+"} ${Math.abs(shift)})`;
}

const rounded = (number) => Number(number.toPrecision(6));

/**
 * Offer to move the function where another domain has another box.
 *
 * @param {object} app
 * @param {object} [before] the domain that the function was written for
 */
export async function offerToFit(app, before) {
  const { spec } = app.store.get();
  const path = ["monitor", "u"];
  const source = path.reduce((value, key) => value?.[key], spec);
  const expression = typeof source === "string" ? source : source?.expression;
  if (!expression || !/(?<![A-Za-z_.])[xy](?!\w)/.test(expression)) return;
  const boxes = await Promise.all([before, spec.domain].map((domain) => boxOf(app.service, domain)));
  if (boxes.includes(null) || String(boxes[0]) === String(boxes[1]) || app.store.get().spec !== spec) return;
  const close = () => app.notice("domain", null);
  const move = () => {
    close();
    const moved = fitted(expression, ...boxes);
    const u = typeof source === "string" ? moved : { ...source, expression: moved };
    app.change({ spec: { ...spec, monitor: { ...spec.monitor, u } } });
  };
  app.notice("domain", { text: "The function was written for the domain before.", actions: [{ text: "Fit it to this one", act: move }, { text: "Keep it", act: close }] });
}

// The smallest box around a domain, which the service knows for every kind; null where it cannot tell.
async function boxOf(service, domain = {}) {
  if ((domain.kind ?? "rectangle") === "rectangle") return [domain.x ?? [0, 1], domain.y ?? [0, 1]];
  return service.check({ expression: "x", domain }).then((found) => found.domain.box).catch(() => null);
}
