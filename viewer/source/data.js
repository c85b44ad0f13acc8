// Reads the compressed columns of numbers (script.py writes them), and draws nothing.

/** Return the numbers of a column: offset, count, bytes of each, unit, times that differences were taken.
 * @param {Uint8Array} bytes @param {number[]} column @returns {Numbers} */
function numbers(bytes, [offset, count, planes, unit, order]) {
  const values = new Int32Array(count);
  for (let plane = 0; plane < planes; plane++) {
    const begin = offset + plane * count;
    for (let i = 0; i < count; i++) values[i] |= bytes[begin + i] << (8 * plane);
  }
  for (let i = 0; i < count; i++) values[i] = (values[i] >>> 1) ^ -(values[i] & 1);
  for (let times = 0; times < order; times++) {
    let sum = 0;
    for (let i = 0; i < count; i++) values[i] = sum = (sum + values[i]) | 0;
  }
  return unit === 1 ? values : Float64Array.from(values, (value) => value * unit);
}

/** Return the bytes of a text in base64. @param {string} text */
export function bytesOf(text) {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

/** Return the value in a compressed text, with its columns as typed arrays. @param {string} text */
export async function unpack(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const content = await new Response(stream).arrayBuffer();
  const length = new DataView(content).getUint32(0, true);
  const head = new TextDecoder().decode(new Uint8Array(content, 4, length));
  const bytes = new Uint8Array(content, 4 + length);
  return JSON.parse(head, (_, value) => (value && value.column ? numbers(bytes, value.column) : value));
}

/** Return the number of values of an ascending array that are at most a value. @param {ArrayLike<number>} values @param {number} value */
export function countUntil(values, value) {
  let low = 0;
  let high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] <= value) low = middle + 1;
    else high = middle;
  }
  return low;
}
