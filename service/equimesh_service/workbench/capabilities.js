// What the service can do, requested once for all panels.

const known = new WeakMap();

/**
 * The answer of `/v1/capabilities`.
 *
 * @param {object} app
 * @returns {Promise<object>}
 */
export function capabilitiesOf(app) {
  const { service } = app;
  if (!known.has(service)) {
    const answer = service.capabilities();
    known.set(service, answer);
    answer.catch(() => known.delete(service)); // the next panel tries again
  }
  return known.get(service);
}

/**
 * When to take which word of a setting, such as those of "monitors".
 *
 * @param {object} app
 * @param {string} list the name of a list in the capabilities
 * @returns {Promise<Object<string, string>>}
 */
export async function usesOf(app, list) {
  const entries = (await capabilitiesOf(app))[list] ?? [];
  return Object.fromEntries(entries.filter((one) => one.when_to_use).map((one) => [one.name, one.when_to_use]));
}
