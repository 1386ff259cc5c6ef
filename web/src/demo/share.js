// Links that replay a session: the seed and all requests, deflated, after the # of the address.

import { bytesOf, through } from "../lib/pack.js";

const MARK = "#do=";
const LONGEST = 32_000; // letters; some programs cut longer addresses

/** The address of this page with a seed and its [frame, request] list; null if it would be too long. */
export async function addressOf(seed, done) {
  const packed = new Uint8Array(await through(new CompressionStream("deflate-raw"), JSON.stringify([seed, done])));
  const letters = Array.from(packed, (byte) => String.fromCharCode(byte)).join("");
  const text = btoa(letters).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
  return text.length > LONGEST ? null : location.href.split("#")[0] + MARK + text;
}

/** The seed and the [frame, request] list of an address; null if it has none. */
export async function readAddress(address) {
  const [, text] = address.split(MARK);
  if (!text) return null;
  const bytes = bytesOf(text.replaceAll("-", "+").replaceAll("_", "/"));
  const [seed, done] = JSON.parse(new TextDecoder().decode(await through(new DecompressionStream("deflate-raw"), bytes)));
  const isRequest = (entry) => Array.isArray(entry) && Number.isInteger(entry[0]) && typeof entry[1]?.do === "string";
  if (!Number.isInteger(seed) || !Array.isArray(done) || !done.every(isRequest)) throw new Error("the address holds no motion");
  return { seed, done };
}
