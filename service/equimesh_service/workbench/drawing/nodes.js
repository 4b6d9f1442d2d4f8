// The nodes of a drawing, in plain arrays: those of the adapted and of the uniform mesh, and the meshes between them.

/**
 * The mesh of a drawing, `{shape, x, y, uniformX, uniformY, isAdapted}`; null where the drawing has no mesh at all.
 *
 * Where one of both meshes is absent, the other stands for it: `isAdapted` is false where the drawing has the uniform
 * mesh alone, since the adapted one is folded.
 *
 * @param {object} drawing
 */
export function meshOf(drawing) {
  const { x, y, uniform_x: uniformX, uniform_y: uniformY } = drawing?.arrays ?? {};
  if (!x && !uniformX) return null;
  const own = x ?? uniformX;
  return {
    shape: own.shape,
    x: own.data,
    y: (y ?? uniformY).data,
    uniformX: (uniformX ?? own).data,
    uniformY: (uniformY ?? y).data,
    isAdapted: Boolean(x),
  };
}

/** Coordinates [x, y] of the nodes between the uniform mesh (0) and the adapted one (1). */
export function blended(mesh, blend) {
  if (blend === 1) return [mesh.x, mesh.y];
  if (blend === 0) return [mesh.uniformX, mesh.uniformY];
  const between = (from, to) => to.map((value, k) => (1 - blend) * from[k] + blend * value);
  return [between(mesh.uniformX, mesh.x), between(mesh.uniformY, mesh.y)];
}

/** The areas of all cells, (n - 1) times (m - 1), by their diagonals. */
export function areasOf([x, y], [n, m]) {
  const areas = new Float32Array((n - 1) * (m - 1));
  for (let i = 0; i < n - 1; i += 1) {
    for (let j = 0; j < m - 1; j += 1) {
      const k = i * m + j;
      const [ax, ay] = [x[k + m + 1] - x[k], y[k + m + 1] - y[k]];
      const [bx, by] = [x[k + 1] - x[k + m], y[k + 1] - y[k + m]];
      areas[i * (m - 1) + j] = Math.abs(ax * by - ay * bx) / 2;
    }
  }
  return areas;
}

/** The area of a cell by its diagonals, from its corners in their order. */
export function areaOf([[ax, ay], [bx, by], [cx, cy], [dx, dy]]) {
  return Math.abs((cx - ax) * (dy - by) - (cy - ay) * (dx - bx)) / 2;
}

/** The four corners of the cell (i, j) in their order around it, as pairs [x, y], of the mesh between both. */
export function cornersBetween(mesh, blend, [i, j]) {
  const m = mesh.shape[1];
  const k = i * m + j;
  const between = (from, to, node) => (1 - blend) * from[node] + blend * to[node];
  return [k, k + m, k + m + 1, k + 1].map((corner) => [
    between(mesh.uniformX, mesh.x, corner),
    between(mesh.uniformY, mesh.y, corner),
  ]);
}

/** The cell [i, j] that a point of the domain is in; null outside. */
export function cellAt([x, y], [n, m], [px, py]) {
  for (let i = 0; i < n - 1; i += 1) {
    for (let j = 0; j < m - 1; j += 1) {
      const k = i * m + j;
      const [a, b, c, d] = [k, k + m, k + m + 1, k + 1];
      if (py < Math.min(y[a], y[b], y[c], y[d]) || py > Math.max(y[a], y[b], y[c], y[d])) continue;
      if (px < Math.min(x[a], x[b], x[c], x[d]) || px > Math.max(x[a], x[b], x[c], x[d])) continue;
      if (isInside([a, b, c, d].map((corner) => [x[corner], y[corner]]), px, py)) return [i, j];
    }
  }
  return null;
}

// Counts the sides that a ray to the right crosses.
function isInside(corners, px, py) {
  let inside = false;
  corners.forEach(([x1, y1], k) => {
    const [x2, y2] = corners[(k + 1) % corners.length];
    if (y1 > py !== y2 > py && px < ((x2 - x1) * (py - y1)) / (y2 - y1) + x1) inside = !inside;
  });
  return inside;
}
