"use strict";
/* The learning curve as an SVG: agreement over the number of labels, a line and a mark a version. */

const CURVE_COLORS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7"];
const CURVE_DASHES = ["", "7 4", "2 3", "9 3 2 3"];

function svgNode(name, attributes, text) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  return node;
}

/* curves: [{name, points: [{labels, mean, spread}]}]; chance: share of the commonest answer. */
function drawCurve(place, curves, chance) {
  place.replaceChildren();
  const points = curves.flatMap((curve) => curve.points);
  if (!points.length) return;
  const width = 560, height = 250, left = 46, right = 150, top = 12, bottom = 38;
  const most = Math.max(...points.map((point) => point.labels));
  const x = (labels) => left + (width - left - right) * labels / most;
  const y = (share) => top + (height - top - bottom) * (1 - share);
  const svg = svgNode("svg", { viewBox: `0 0 ${width} ${height}`, role: "img",
    "aria-label": "Agreement over the number of labels" });
  for (const share of [0, 0.25, 0.5, 0.75, 1]) {
    svg.append(svgNode("line", { x1: left, x2: width - right, y1: y(share), y2: y(share), stroke: "#d0d0cc" }));
    svg.append(svgNode("text", { x: left - 6, y: y(share) + 4, "text-anchor": "end", "font-size": 12 }, `${Math.round(100 * share)} %`));
  }
  for (const labels of [...new Set(points.map((point) => point.labels))]) {
    svg.append(svgNode("text", { x: x(labels), y: height - bottom + 16, "text-anchor": "middle", "font-size": 12 }, labels));
  }
  svg.append(svgNode("text", { x: (left + width - right) / 2, y: height - 4, "text-anchor": "middle", "font-size": 12 }, "labels"));
  if (chance !== null && chance !== undefined) {
    svg.append(svgNode("line", { x1: left, x2: width - right, y1: y(chance), y2: y(chance), stroke: "#1c2026", "stroke-dasharray": "1 4" }));
    svg.append(svgNode("text", { x: width - right + 8, y: y(chance) + 4, "font-size": 11 }, "commonest answer"));
  }
  curves.forEach((curve, k) => {
    const color = CURVE_COLORS[k % CURVE_COLORS.length];
    for (const point of curve.points) {
      svg.append(svgNode("line", { x1: x(point.labels), x2: x(point.labels), y1: y(Math.max(0, point.mean - point.spread)), y2: y(Math.min(1, point.mean + point.spread)), stroke: color, opacity: 0.5 }));
      svg.append(svgNode("circle", { cx: x(point.labels), cy: y(point.mean), r: 3, fill: color }));
    }
    svg.append(svgNode("polyline", { points: curve.points.map((p) => `${x(p.labels)},${y(p.mean)}`).join(" "),
      fill: "none", stroke: color, "stroke-width": 2, "stroke-dasharray": CURVE_DASHES[k % CURVE_DASHES.length] }));
    svg.append(svgNode("line", { x1: width - right + 8, x2: width - right + 34, y1: top + 14 + 18 * k, y2: top + 14 + 18 * k,
      stroke: color, "stroke-width": 2, "stroke-dasharray": CURVE_DASHES[k % CURVE_DASHES.length] }));
    svg.append(svgNode("text", { x: width - right + 40, y: top + 18 + 18 * k, "font-size": 12 }, curve.name));
  });
  place.append(svg);
}
