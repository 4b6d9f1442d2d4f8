// The nodes of a drawing, in plain arrays: those of the adapted and of the uniform mesh, and the meshes between them.

/**
 * The mesh of a drawing, `{shape, blocks, x, y, uniformX, uniformY, isAdapted}`; null where the drawing has no mesh.
 *
 * A mesh of blocks has its initial mesh in place of the uniform one.  `blocks` are `{name, shape, node, cell}`: the points of a block in both directions, and the numbers of its first node
 * and its first cell.  The node (i, j) of a block has the number node + i m + j.  A grid is one block.
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
    blocks: blocksOf(drawing.document.blocks ?? [{ name: "", shape: own.shape }]),
    x: own.data,
    y: (y ?? uniformY).data,
    uniformX: (uniformX ?? own).data,
    uniformY: (uniformY ?? y).data,
    isAdapted: Boolean(x),
    isOfBlocks: Boolean(drawing.document.blocks),
  };
}

/** Coordinates [x, y] of the nodes between the uniform mesh (0) and the adapted one (1). */
export function blended(mesh, blend) {
  if (blend === 1) return [mesh.x, mesh.y];
  if (blend === 0) return [mesh.uniformX, mesh.uniformY];
  const between = (from, to) => to.map((value, k) => (1 - blend) * from[k] + blend * value);
  return [between(mesh.uniformX, mesh.x), between(mesh.uniformY, mesh.y)];
}

// The blocks with the numbers of their first nodes and cells.
function blocksOf(list) {
  let [node, cell] = [0, 0];
  return list.map(({ name, shape: [n, m] }) => {
    const block = { name, shape: [n, m], node, cell };
    node += n * m;
    cell += (n - 1) * (m - 1);
    return block;
  });
}

/** The number of cells of a mesh. */
export const cellCount = (mesh) => mesh.blocks.reduce((sum, { shape: [n, m] }) => sum + (n - 1) * (m - 1), 0);

/**
 * Call `visit(corners, cell, [b, i, j])` for each cell: the numbers of its corners in their order around it, its number,
 * and its place, which is the number of its block and of its first node there.  It ends where `visit` returns true.
 *
 * @param {object} mesh
 * @param {(corners: number[], cell: number, place: number[]) => any} visit
 */
export function eachCell(mesh, visit) {
  for (const [b, { shape: [n, m], node, cell }] of mesh.blocks.entries()) {
    for (let i = 0; i < n - 1; i += 1) {
      for (let j = 0; j < m - 1; j += 1) {
        const k = node + i * m + j;
        if (visit([k, k + m, k + m + 1, k + 1], cell + i * (m - 1) + j, [b, i, j])) return;
      }
    }
  }
}

/** The numbers of the corners of the cell at a place [b, i, j], in their order around it, and its own number. */
export function cornersOf(mesh, [b, i, j]) {
  const { shape: [, m], node, cell } = mesh.blocks[b];
  const k = node + i * m + j;
  return { corners: [k, k + m, k + m + 1, k + 1], number: cell + i * (m - 1) + j };
}

/** The lines of all blocks, as lists of the numbers of their nodes. */
export function linesOf(mesh) {
  return mesh.blocks.flatMap(({ shape: [n, m], node }) => [
    ...Array.from({ length: n }, (_, i) => Array.from({ length: m }, (_, j) => node + i * m + j)),
    ...Array.from({ length: m }, (_, j) => Array.from({ length: n }, (_, i) => node + i * m + j)),
  ]);
}

/** The areas of all cells, by their diagonals. */
export function areasOf([x, y], mesh) {
  const areas = new Float32Array(cellCount(mesh));
  eachCell(mesh, ([a, b, c, d], cell) => {
    const [ax, ay] = [x[c] - x[a], y[c] - y[a]];
    const [bx, by] = [x[d] - x[b], y[d] - y[b]];
    areas[cell] = Math.abs(ax * by - ay * bx) / 2;
  });
  return areas;
}

/** The area of a cell by its diagonals, from its corners in their order. */
export function areaOf([[ax, ay], [bx, by], [cx, cy], [dx, dy]]) {
  return Math.abs((cx - ax) * (dy - by) - (cy - ay) * (dx - bx)) / 2;
}

/** The four corners of the cell at a place in their order around it, as pairs [x, y], of the mesh between both. */
export function cornersBetween(mesh, blend, place) {
  const between = (from, to, node) => (1 - blend) * from[node] + blend * to[node];
  return cornersOf(mesh, place).corners.map((corner) => [
    between(mesh.uniformX, mesh.x, corner),
    between(mesh.uniformY, mesh.y, corner),
  ]);
}

/** The place [b, i, j] of the cell that a point of the domain is in; null outside. */
export function cellAt([x, y], mesh, [px, py]) {
  let found = null;
  eachCell(mesh, ([a, b, c, d], _, place) => {
    if (py < Math.min(y[a], y[b], y[c], y[d]) || py > Math.max(y[a], y[b], y[c], y[d])) return false;
    if (px < Math.min(x[a], x[b], x[c], x[d]) || px > Math.max(x[a], x[b], x[c], x[d])) return false;
    if (isInside([a, b, c, d].map((corner) => [x[corner], y[corner]]), px, py)) found = place;
    return found;
  });
  return found;
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
