// A spec as a request of curl.

import { command, quoted } from "./shell.js";

// Seconds that the request waits for the mesh: the limit of the service, unless it was changed.
const WAIT = 30;

/**
 * A command that requests the mesh, and writes its file.
 *
 * @param {object} spec
 * @param {{url: string, format: {name: string, suffix: string}, hasKey: boolean}} options
 */
export function curlOf(spec, { url, format, hasKey }) {
  return command([
    `curl -sS --fail-with-body ${quoted(`${url}v1/meshes?format=${format.name}`)}`,
    // The key itself is never written anywhere.
    ...(hasKey ? ['-H "Authorization: Bearer $EQUIMESH_KEY"'] : []),
    `-H 'Content-Type: application/json' -H 'Prefer: wait=${WAIT}' -o ${quoted(`mesh${format.suffix}`)}`,
    `-d ${quoted(JSON.stringify(spec))}`,
  ]);
}
