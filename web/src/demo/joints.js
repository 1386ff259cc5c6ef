// The canonical joints of a character's nodes, as rig/gltf_nodes.py and rig/names.py find them, by their tables.

/** The joints of a .glb's JSON: nodes of the skeleton with parents first, their names and parents, and the avatar's own table. */
export function findJoints({ nodes = [], skins = [], extensions = {} }, tables) {
  const { bones } = tables;
  const above = nodes.map(() => -1);
  nodes.forEach(({ children = [] }, node) => children.forEach((child) => (above[child] = node)));
  const order = [];
  const visit = (node) => [order.push(node), nodes[node].children?.forEach(visit)];
  nodes.forEach((_, node) => above[node] < 0 && visit(node));
  const humanBones = (extensions.VRMC_vrm ?? extensions.VRM)?.humanoid?.humanBones ?? {};
  const table = Array.isArray(humanBones) ? Object.fromEntries(humanBones.map(({ bone, node }) => [bone, node])) : Object.fromEntries(Object.entries(humanBones).map(([bone, entry]) => [bone, entry?.node]));
  const avatar = Object.entries(bones).filter(([bone]) => nodes[table[bone]]).map(([bone, ours]) => [ours, table[bone]]);
  const named = [...avatar.map(([, node]) => node), ...skins.flatMap(({ joints }) => joints)];
  const wanted = new Set(named.length ? named : order.filter((node) => nodes[node].mesh === undefined));
  if (!wanted.size) throw new Error("it has no skeleton, only meshes; rig it first (in Blender, Mixamo or Mesh2Motion)");
  const tops = nodes.map((_, node) => node);
  for (const node of order) if (above[node] >= 0) tops[node] = tops[above[node]];
  if (skins.some(({ joints }) => new Set(joints.map((node) => tops[node])).size > 1)) throw new Error("a skin has joints in two trees, expected one skeleton");
  const byTop = {};
  for (const node of wanted) (byTop[tops[node]] ??= []).push(node);
  const [main, other] = Object.values(byTop).sort((a, b) => b.length - a.length);
  if (other && 2 * other.length >= main.length) throw new Error("it has two skeletons, expected one character");
  checkSkins(nodes, skins, above, tables);
  const below = nodes.map((_, node) => Number(main.includes(node)));
  for (const node of [...order].reverse()) if (above[node] >= 0) below[above[node]] += below[node];
  const inside = [order.filter((node) => below[node] === main.length).at(-1)];
  for (const node of order) if (below[node] && inside.includes(above[node])) inside.push(node);
  const number = new Map(inside.map((node, joint) => [node, joint]));
  return {
    nodes: inside,
    names: inside.map((node) => nameOf(nodes[node])),
    parents: inside.map((node) => number.get(above[node]) ?? -1),
    avatar: Object.fromEntries(avatar.map(([ours, node]) => [ours, number.get(node)])),
  };
}

// Throws for two skins of different people below one node, as gltf_nodes.py's _check_skins.
function checkSkins(nodes, skins, above, tables) {
  const path = (node) => (node < 0 ? [] : [...path(above[node]), node]);
  const words = wordsOf(tables);
  const limbs = ({ joints }) => new Set(joints.map((node) => {
    const [side, part] = namePart(nameOf(nodes[node]), { ...tables, words });
    return side + Object.keys(tables.limbParts).find((limb) => tables.limbParts[limb].includes(part));
  }));
  const people = skins.filter((skin) => ["Left", "Right"].every((side) => Object.keys(tables.limbParts).every((limb) => limbs(skin).has(side + limb))));
  const shared = people.map(({ joints: [first, ...others] }) => path(first).filter((node) => others.every((other) => path(other).includes(node))));
  if (shared.some((one) => shared.some((other) => one.some((node, n) => n < other.length && other[n] !== node)))) throw new Error("it has two skeletons, expected one character");
}

const nameOf = ({ name }) => (typeof name === "string" ? name : "");

const wordsOf = ({ parts }) => Object.fromEntries(Object.entries(parts).flatMap(([part, all]) => all.map((word) => [word, part])));

/** Side and part of a joint's name, as names.py's name_part. */
function namePart(name, { tokens, sided, sides, helpers, words }) {
  const found = (name.match(new RegExp(tokens, "g")) ?? []).map((token) => token.toLowerCase());
  for (let start = 0; start < found.length; start++) {
    const match = new RegExp(`^(?:${sided})$`).exec(found.slice(start).join(""));
    if (!match) continue;
    const before = found.slice(0, start);
    if (before.some((token) => helpers.includes(token))) return ["", "other"];
    const side = match[1] || match[4] || before.find((token) => Object.hasOwn(sides, token));
    return [sides[side] ?? "", words[match[2] || match[3] || match[5]]];
  }
  return ["", ""];
}

/** Canonical names to joints, parents before children; throws with the words that were looked for. @param {number[][]} rest places (J, 3) */
export function mapJoints({ names, parents, avatar }, rest, tables) {
  return new Mapper(names, parents, rest, tables).map(avatar);
}

class Mapper {
  constructor(names, parents, rest, tables) {
    const words = wordsOf(tables);
    Object.assign(this, { names, parents, rest, tables, places: {} });
    this.parts = names.map((name) => namePart(name, { ...tables, words }));
    this.paths = [];
    parents.forEach((parent, joint) => this.paths.push([...(this.paths[parent] ?? []), joint]));
    this.size = names.map((_, joint) => this.paths.filter((path) => path.includes(joint)).length);
  }

  map(avatar) {
    const { places, tables } = this;
    Object.assign(places, avatar);
    const limbs = Object.keys(avatar).length ? [] : ["Left", "Right"];
    limbs.forEach((side) => [this.#leg(side), this.#arm(side)]);
    const lacking = tables.needed.filter((name) => places[name] === undefined);
    if (lacking.length) throw new Error(this.#lacking(lacking));
    if (new Set(Object.values(places)).size < Object.keys(places).length) throw new Error("one joint matches two limbs");
    places.Hips ??= this.#hips();
    this.#check();
    const chest = this.#spine();
    this.#neck(chest);
    for (const side of ["Left", "Right"]) {
      const path = this.paths[places[`${side}Arm`]];
      const between = path.slice(path.indexOf(chest) + 1, -1).filter((joint) => this.parts[joint][1] !== "neck");
      if (path.includes(chest)) this.#put(`${side}Shoulder`, between[0]);
    }
    return Object.fromEntries(tables.names.filter((name) => places[name] !== undefined).map((name) => [name, places[name]]));
  }

  #lacking(names) {
    const part = { UpLeg: "thigh", Leg: "shin", Arm: "upperarm", ForeArm: "forearm" }[names[0].replace(/Left|Right/, "")];
    const seen = this.names.slice(0, 12).join(", ") + (this.names.length > 12 ? ", …" : "");
    return `no joint for ${names.join(", ")}: looked for a side (left, right, L, R) with ${this.tables.parts[part].join(", ")}; it has ${seen}`;
  }

  /** The joint of a side and some parts with the most below it. */
  #find(side, parts, under, carries = false) {
    const fits = ([its, part], joint) =>
      its === side && parts.includes(part) && this.size[joint] > carries && (under === undefined || this.paths[joint].slice(0, -1).includes(under));
    return this.parts.flatMap((part, joint) => (fits(part, joint) ? [joint] : [])).sort((a, b) => this.size[b] - this.size[a])[0];
  }

  #put(name, joint) {
    if (joint !== undefined) this.places[name] = joint;
    return joint;
  }

  #leg(side) {
    let leg = this.#find(side, ["leg"], undefined, true);
    if (leg !== undefined && this.#find(side, ["shin"], leg) === undefined) leg = undefined;
    const thigh = this.#put(`${side}UpLeg`, this.#find(side, ["thigh"], undefined, true) ?? leg ?? this.#find(side, ["hip"], undefined, true));
    if (thigh === undefined) return;
    const shin = this.#put(`${side}Leg`, this.#find(side, ["shin", "leg"], thigh));
    if (shin === undefined) return;
    const foot = this.#put(`${side}Foot`, this.#find(side, ["foot"], shin) ?? this.#find(side, ["toe"], shin));
    if (foot !== undefined) this.#put(`${side}ToeBase`, this.#find(side, ["toe"], foot) ?? this.#find(side, ["foot"], foot));
  }

  #arm(side) {
    const upper = this.#put(`${side}Arm`, ["upperarm", "arm", "shoulder"].reduce((found, part) => found ?? this.#find(side, [part], undefined, true), undefined));
    if (upper === undefined) return;
    const lower = this.#put(`${side}ForeArm`, this.#find(side, ["forearm", "arm"], upper));
    if (lower !== undefined) this.#put(`${side}Hand`, this.#find(side, ["hand"], lower));
  }

  common(...joints) {
    const [first, ...others] = joints.map((joint) => this.paths[joint]);
    return first.filter((joint) => others.every((path) => path.includes(joint))).at(-1);
  }

  #hips() {
    const thighs = [this.places.LeftUpLeg, this.places.RightUpLeg];
    const fork = this.common(...thighs);
    if (thighs.includes(fork)) throw new Error("one thigh is a descendant of the other");
    return this.paths[fork].filter((joint) => ["hips", "hip"].includes(this.parts[joint][1]) && !this.parts[joint][0]).at(-1) ?? fork;
  }

  // A limb joint hangs from the one above it.
  #check() {
    for (const [name, joint] of Object.entries(this.places)) {
      const side = name.match(/Left|Right/)?.[0];
      const [, top] = Object.entries(this.tables.hangs).find(([part]) => side && name.endsWith(part)) ?? [];
      const above = this.places[top === "Hips" ? top : side + top];
      if (top && above !== undefined && !this.paths[joint].slice(0, -1).includes(above)) throw new Error(`${this.names[joint]}, taken for ${name}, does not hang from ${this.names[above]}`);
    }
  }

  /** Length along the bones from the common ancestor of two joints to the second. */
  #length(above, below) {
    const path = this.paths[below];
    const steps = path.slice(path.indexOf(this.common(above, below)) + 1);
    return steps.reduce((sum, joint) => sum + far(this.rest[joint], this.rest[this.parents[joint]]), 0);
  }

  #spine() {
    const { places, rest, tables } = this;
    const fork = this.common(places.LeftArm, places.RightArm);
    const path = this.paths[fork];
    const spine = path.slice(path.indexOf(this.common(places.Hips, fork)) + 1).filter((joint) => !["neck", "head"].includes(this.parts[joint][1]));
    const chest = spine.at(-1) ?? fork;
    const picked = spine.length <= 3 ? spine : [spine[0], spine[Math.floor(spine.length / 2)], chest];
    const arms = rest[places.LeftArm].map((value, axis) => (value + rest[places.RightArm][axis]) / 2);
    const top = Math.max(1e-6, this.#length(places.Hips, chest) + far(arms, rest[chest]));
    const shares = picked.map((joint) => this.#length(places.Hips, joint) / top);
    const misfit = (names) => names.reduce((sum, name, n) => sum + Math.abs(tables.spine[name] - shares[n]), 0);
    const best = choices(Object.keys(tables.spine), picked.length).reduce((a, b) => (misfit(b) < misfit(a) ? b : a));
    best.forEach((name, n) => (places[name] = picked[n]));
    return chest;
  }

  #neck(chest) {
    const head = this.#put("Head", this.places.Head ?? this.#find("", ["head"], chest));
    if (head === undefined) this.#put("Neck", this.#find("", ["neck"], chest));
    else {
      const necks = this.paths[head].slice(this.paths[head].indexOf(chest) + 1, -1);
      this.#put("Neck", necks[0]);
      if (necks.length > 1) this.#put("Neck1", necks.at(-1));
    }
  }
}

const far = (a, b) => Math.hypot(...a.map((value, axis) => value - b[axis]));

// All choices of `count` of some items, in their order.
function choices(items, count) {
  if (!count) return [[]];
  return items.flatMap((item, n) => choices(items.slice(n + 1), count - 1).map((more) => [item, ...more]));
}
