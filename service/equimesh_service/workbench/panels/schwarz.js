// The panel of the Schwarz iteration: subdomains, what they exchange, and what speeds the iteration up.

import { choiceField, faultLine, flagField, follow, numberField, pairFields, wordOrNumberField } from "../bound.js";
import { usesOf } from "../capabilities.js";
import { element, field } from "../dom.js";

const TRANSMISSIONS = [
  ["optimized", "optimized"],
  ["classical", "classical"],
  ["linear_robin", "linear Robin"],
  ["nonlinear_robin", "nonlinear Robin"],
];
const ROBIN = new Set(["linear_robin", "nonlinear_robin"]);
const PLACE = ["schwarz", "transmission"];

/**
 * The panel of the Schwarz iteration.
 *
 * @param {HTMLElement} section
 * @param {object} app
 */
export function create(section, app) {
  let last = {}; // what was set before the iteration was switched off
  const input = element("input", { type: "checkbox", onchange: () => {
    const { schwarz, ...spec } = app.store.get().spec;
    last = schwarz ?? last;
    app.store.update({ spec: input.checked ? { ...spec, schwarz: last } : spec });
  } });
  const isOn = field("Divide into subdomains", input, {
    inline: true,
    help: "Each subdomain is solved by itself, again and again, with what its neighbours found. The mesh is that of a "
      + "single domain with the same monitor; with least error it is about as good. The automatic monitor then leaves "
      + "least error out, and the error can be larger.",
  });
  const settings = element("div", {},
    pairFields(app, ["subdomains along xi", "along eta"], ["schwarz", "subdomains"], [2, 1], { min: 1, step: 1 }),
    numberField(app, "Overlap in points", ["schwarz", "overlap"], { fallback: 4, min: 1, step: 1, help: "For least error in layers of cells." }),
    transmission(app),
    more(app));
  section.append(isOn, faultLine(app, (pointer) => /^\/schwarz(\/subdomains|\/transmission)?$/.test(pointer)), settings);
  follow(app, ["schwarz"], (schwarz) => {
    input.checked = Boolean(schwarz);
    settings.hidden = !schwarz;
  });
}

// The condition on interfaces, with the setting that its kind has.
function transmission(app) {
  const put = (kind) => app.store.set(["spec", ...PLACE], kind === "optimized" ? undefined : { kind });
  const kind = choiceField(app, "Transmission condition", [...PLACE, "kind"], {
    choices: TRANSMISSIONS,
    fallback: "optimized",
    uses: usesOf(app, "transmissions"),
    onchoose: put,
  });
  const data = choiceField(app, "Data of an interface", [...PLACE, "data"], {
    choices: [["line_sums", "sums of whole lines"], ["local", "the neighbour alone"]],
    fallback: "line_sums",
    uses: usesOf(app, "interface_data"),
    // A condition that has a setting must be named.
    onchoose: (value) => app.store.set(["spec", ...PLACE], value === "local" ? { kind: "optimized", data: value } : undefined),
  });
  const p = wordOrNumberField(app, "Parameter p", [...PLACE, "p"], { words: [["auto", "automatic"]], fallback: "auto", number: 1, min: 0 });
  follow(app, [...PLACE, "kind"], (value = "optimized") => {
    data.hidden = value !== "optimized";
    p.hidden = !ROBIN.has(value);
  });
  return element("div", {}, kind, data, p);
}

// The settings that few people change.
function more(app) {
  return element("details", { class: "more" }, element("summary", {}, "Order, speed, end"),
    choiceField(app, "Ordering", ["schwarz", "ordering"], {
      choices: ["parallel", "alternating", "symmetric", "coloured"].map((word) => [word, word]),
      fallback: "parallel",
      uses: usesOf(app, "orderings"),
    }),
    wordOrNumberField(app, "Line corrections", ["schwarz", "line_correction"], {
      words: [["auto", "automatic"]],
      fallback: "auto",
      number: 3,
      min: 0,
      max: 10,
      step: 1,
      help: "How many times all grid lines are corrected after every iteration.",
    }),
    choiceField(app, "Acceleration", ["schwarz", "acceleration"], {
      choices: [["auto", "automatic"], ["none", "none"], ["anderson", "Anderson"], ["newton", "Newton"]],
      fallback: "auto",
      uses: usesOf(app, "accelerations"),
    }),
    choiceField(app, "Local solver", ["schwarz", "local_solver"], {
      choices: [["sweeps", "sweeps"], ["newton", "Newton"]],
      fallback: "sweeps",
      uses: usesOf(app, "local_solvers"),
    }),
    flagField(app, "Fall back to the optimized condition", ["schwarz", "fallback"], {
      fallback: true,
      help: "Where another condition stalls, this one takes over.",
    }),
    wordOrNumberField(app, "Tolerance", ["schwarz", "tolerance"], {
      words: [["discretization", "a fifth of the error of the grid"], ["", "none: run all iterations"]],
      fallback: 1e-10,
      number: 1e-10,
      min: 0,
    }),
    numberField(app, "Most iterations", ["schwarz", "max_iterations"], { fallback: 100, min: 1, step: 1 }),
    numberField(app, "For least error: steps in one exchange", ["schwarz", "local_steps"], { fallback: 8, min: 1, max: 1000, step: 1 }),
    wordOrNumberField(app, "For least error: most exchanges", ["schwarz", "max_exchanges"], {
      words: [["", "as many as the steps of the whole grid take"]],
      fallback: null,
      number: 4,
      min: 1,
      max: 1000,
      step: 1,
    }),
    flagField(app, "Compare with the single domain", ["schwarz", "compare_single_domain"], { help: "Also solves without subdomains, and shows the error against that." }));
}
