// A user's .glb or .vrm: read and checked, and written again with a motion as one animation more.

import { Group, Matrix4, Quaternion, Vector3 } from "three";
import { readCharacter } from "../lib/hero.js";
import { Rig } from "../lib/rig.js";
import { findJoints } from "./joints.js";
import { rigOf } from "./rig.js";

const CM = 0.01;
const [MAGIC, JSON_CHUNK, BIN_CHUNK] = [0x46546c67, 0x4e4f534a, 0x004e4942];

/** The body of a character's file for LocalLink: its rig for the page, and offsets for the kernels; throws a line for the user. */
export async function heroBody(file, usual, tables) {
  if (file.size > tables.mostBytes) throw new Error(`it has ${Math.round(file.size / 1e6)} MB, expected at most ${tables.mostBytes / 1e6}`);
  const bytes = await file.arrayBuffer();
  const { json } = split(bytes);
  checkTree(json);
  const lacking = (json.extensionsRequired ?? []).filter((name) => /draco|basisu/.test(name));
  if (lacking.length) throw new Error(`it is compressed (${lacking.join(", ")}), which this page does not unpack; save it without`);
  const joints = findJoints(json, tables);
  if (!json.meshes?.length) throw new Error("it has no meshes to show");
  const read = await readCharacter(bytes).catch((error) => {
    throw new Error(`it cannot be read (${error.message})`);
  });
  const { data, kernel, map } = rigOf(read, joints, tables);
  return { ...usual, offsets: kernel.offsets.map((cm) => cm * CM), body: null, hero: { ...data, bytes: () => bytes }, kernel, map };
}

/** The bytes of the character's file with frames (cm) as one animation more. */
export async function heroBytes(body, frames, fps) {
  const rig = await Rig.from(body);
  const hero = await rig.newHero();
  new Group().add(hero);
  const pose = rig.newPose();
  const turning = new Map([...body.hero.drives.map(([node]) => node), ...body.hero.twists.flatMap(({ shares }) => shares.map(([node]) => node))].map((node) => [node, []]));
  const moving = new Map(body.hero.moves.map(([node]) => [node, []]));
  for (const { root, rotations } of frames) {
    hero.setPose(pose.set(rig, rotations, 0, root.map((cm) => cm * CM), 0));
    for (const [node, values] of turning) {
      const now = hero.nodes[node].quaternion.toArray();
      const along = now.reduce((sum, value, n) => sum + value * (values.at(n - 4) ?? 1), 0);
      values.push(...now.map((value) => (values.length && along < 0 ? -value : value)));
    }
    for (const [node, values] of moving) values.push(...hero.nodes[node].position.toArray());
  }
  hero.dispose();
  const tracks = [...[...turning].map(([node, values]) => [node, "rotation", values]), ...[...moving].map(([node, values]) => [node, "translation", values])];
  return added(body.hero.bytes(), tracks, fps);
}

// The JSON of a binary glTF file and its other chunks.
function split(bytes) {
  const view = new DataView(bytes);
  if (bytes.byteLength < 20 || view.getUint32(0, true) !== MAGIC || view.getUint32(4, true) !== 2) throw new Error("it is no binary glTF 2.0 file (.glb, .vrm)");
  const chunks = [];
  for (let at = 12; at + 8 <= bytes.byteLength; at += 8 + view.getUint32(at, true)) {
    const size = view.getUint32(at, true);
    if (at + 8 + size > bytes.byteLength) throw new Error("it ends in the middle of a chunk");
    chunks.push([view.getUint32(at + 4, true), new Uint8Array(bytes, at + 8, size)]);
  }
  if (chunks[0]?.[0] !== JSON_CHUNK) throw new Error("it has no JSON chunk");
  try {
    return { json: JSON.parse(new TextDecoder().decode(chunks[0][1])), chunks: chunks.slice(1) };
  } catch {
    throw new Error("its JSON chunk is damaged");
  }
}

// Nodes are a tree, skins have joints among them, and all bytes lie in the file.
function checkTree({ nodes = [], skins = [], buffers = [] }) {
  if (![nodes, skins, buffers].every((list) => Array.isArray(list) && list.every((one) => one && typeof one === "object"))) throw new Error("its nodes, skins or buffers are no lists of objects");
  if (!skins.every(({ joints }) => Array.isArray(joints) && joints.every((joint) => nodes[joint]))) throw new Error("a skin has joints that are no nodes of the file");
  const children = nodes.flatMap((node) => node.children ?? []);
  if (new Set(children).size < children.length || children.some((child) => !nodes[child])) throw new Error("its nodes are no tree");
  const roots = nodes.flatMap((_, node) => (children.includes(node) ? [] : [node]));
  let count = 0;
  for (const waiting = [...roots]; waiting.length; count++) waiting.push(...(nodes[waiting.pop()].children ?? []));
  if (count < nodes.length) throw new Error("its nodes form a circle");
  const away = buffers.find(({ uri }) => uri && !uri.startsWith("data:"));
  if (away) throw new Error(`its buffer ${away.uri.slice(0, 60)} is another file; save all in one`);
}

// A file with tracks [node, path, numbers] as an animation. Its bytes and all that it had stay.
function added(bytes, tracks, fps) {
  const { json, chunks } = split(bytes);
  const list = (name) => (json[name] ??= []);
  const old = chunks.find(([kind]) => kind === BIN_CHUNK)?.[1] ?? new Uint8Array();
  const own = !json.buffers?.[0]?.uri;
  if (!own) throw new Error("the buffer of the file is text; save it as a plain .glb");
  const start = Math.ceil(old.length / 4) * 4;
  const times = tracks[0][2].length / 4;
  const parts = [Array.from({ length: times }, (_, frame) => frame / fps), ...tracks.map(([, , values]) => values)].map((values) => new Float32Array(values));
  let at = start;
  const accessors = parts.map((values) => {
    const width = values.length / times;
    const bufferView = list("bufferViews").push({ buffer: 0, byteOffset: at, byteLength: values.byteLength }) - 1;
    at += values.byteLength;
    const bounds = width === 1 ? { min: [0], max: [values.at(-1)] } : {};
    return list("accessors").push({ bufferView, componentType: 5126, count: times, type: { 1: "SCALAR", 3: "VEC3", 4: "VEC4" }[width], ...bounds }) - 1;
  });
  const samplers = tracks.map((_, n) => ({ input: accessors[0], output: accessors[n + 1] }));
  const channels = tracks.map(([node, path], sampler) => ({ sampler, target: { node, path } }));
  list("animations").push({ name: "recording", samplers, channels });
  if (json.buffers) json.buffers[0].byteLength = at;
  else json.buffers = [{ byteLength: at }];
  for (const [node] of tracks) asParts(json.nodes[node]);
  const data = new Uint8Array(at);
  data.set(old);
  parts.reduce((place, values) => (data.set(new Uint8Array(values.buffer), place), place + values.byteLength), start);
  const text = new TextEncoder().encode(JSON.stringify(json));
  const padded = new Uint8Array(Math.ceil(text.length / 4) * 4).fill(32);
  padded.set(text);
  const others = chunks.filter(([kind]) => kind !== BIN_CHUNK);
  const written = [[JSON_CHUNK, padded], [BIN_CHUNK, data], ...others].flatMap(([kind, chunk]) => [new Uint32Array([chunk.length, kind]), chunk]);
  return new Blob([new Uint32Array([MAGIC, 2, 12 + written.reduce((sum, { byteLength }) => sum + byteLength, 0)]), ...written]);
}

// Animated nodes may have no matrix.
function asParts(node) {
  if (!node.matrix) return;
  const [translation, rotation, scale] = [new Vector3(), new Quaternion(), new Vector3()];
  new Matrix4().fromArray(node.matrix).decompose(translation, rotation, scale);
  Object.assign(node, { translation: translation.toArray(), rotation: rotation.toArray(), scale: scale.toArray() });
  delete node.matrix;
}
