// Where figures stand on the pages of the site: in place of the picture of the front page, and behind a button below each
// picture of the gallery. `generator.figures` puts the figure and the problems in front of this.

const { createFigure, element } = $figure;
const FIRST = {
  title: "Wavy front",
  spec: { monitor: { u: { expression: "tanh(k*(y - 0.5 - 0.1*sin(2*pi*x)))", parameters: { k: 40 } } }, grid: { n_xi: 33, n_eta: 33 } },
  sliders: { k: { min: 5, max: 100 } },
};
const SOURCE = "Computed by this page itself. Nodes by arc length agree with those of equimesh solve to a thousandth of the domain, gains of least error on 33 points to a tenth.";

function figureIn(place, problems) {
  const root = element("div", { role: "region", "aria-label": "A mesh to move" });
  place.after(root);
  const figure = createFigure(root, { problems });
  root.append(element("p", { class: "mesh-figure-legend" }, SOURCE));
  return { root, figure };
}

function nameOf(picture) {
  return picture.getAttribute("src").split("/").pop().replace(/\d*\.\w+$/, "");
}

const article = document.querySelector("article");
for (const picture of article.querySelectorAll("p > img, p > a > img")) {
  const paragraph = picture.closest("p");
  const problem = PROBLEMS.find(({ name }) => name === nameOf(picture));
  if (nameOf(picture) === "uniform-and-adapted") {
    figureIn(paragraph, [FIRST, ...PROBLEMS]);
    paragraph.hidden = true;
  } else if (problem && !picture.closest("table")) {
    const button = element("button", { type: "button", class: "mesh-figure-open", onclick: () => {
      const { root } = figureIn(paragraph, [problem]);
      paragraph.hidden = true;
      button.remove();
      root.querySelector("input").focus();
    } }, `Move it: ${problem.title}`);
    paragraph.append(button);
  }
}
