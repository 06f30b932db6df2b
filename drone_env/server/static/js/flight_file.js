// Reads files of flights: a record as JSON, or one per line. What the records say is for the server to check.

const MOST_BYTES = 20_000_000;
const ENDINGS = [".json", ".jsonl"];

/**
 * The records in a file.
 *
 * @param {File} file
 * @returns {Promise<object[]>} At least one.
 * @throws {Error} Saying what is wrong with the file, and what is allowed.
 */
export async function readFlights(file) {
  if (!ENDINGS.some((ending) => file.name.toLowerCase().endsWith(ending))) {
    throw new Error(`${file.name} is not a file of flights: its name must end in ${ENDINGS.join(" or ")}.`);
  }
  if (file.size > MOST_BYTES) {
    throw new Error(`${file.name} has ${Math.round(file.size / 1e6)} MB; at most ${MOST_BYTES / 1e6} MB can be read.`);
  }
  const text = (await file.text()).replace(/^\uFEFF/, "");
  if (!text.trim()) throw new Error(`${file.name} is empty.`);
  const whole = parsed(text);
  if (whole.ok) return [record(whole.value, file.name)];
  const lines = text
    .split("\n")
    .map((line, i) => [line, i + 1])
    .filter(([line]) => line.trim());
  return lines.map(([line, number]) => {
    const one = parsed(line);
    const where = lines.length > 1 ? `${file.name}, line ${number}` : file.name;
    if (!one.ok) throw new Error(`${where} is not JSON: ${one.error}.`);
    return record(one.value, where);
  });
}

function parsed(text) {
  try {
    return { ok: true, value: JSON.parse(text) };
  } catch (error) {
    return { ok: false, error: error.message };
  }
}

function record(value, where) {
  if (value === null || typeof value !== "object" || Array.isArray(value)) {
    throw new Error(`${where} is not the record of a flight: a JSON object is needed.`);
  }
  return value;
}
