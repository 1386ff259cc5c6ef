// What makes the canonical joints move a user's character, as the rig of Python does it: rig/rest_pose.py compares the rest
// poses, rig/to_rig.py gives the body of the rig, play/on_rig.py its height.

import { Matrix4, Quaternion, Vector3 } from "three";
import { mapJoints } from "./joints.js";
import { skinBeside, solesOf } from "./soles.js";

const CM = 0.01;
const UP = new Vector3(0, 1, 0);
const AHEAD = new Vector3(0, 0, 1);
const DEGREES = 180 / Math.PI;
const radians = (degrees) => degrees / DEGREES;
const rotated = (turn, vector) => vector.clone().applyQuaternion(turn);
const angle = (a, b) => DEGREES * a.angleTo(b);
const product = (...turns) => turns.reduce((all, turn) => all.multiply(turn), new Quaternion());

/**
 * The data of character_data.py for live motion on a character, and of its body for the kernels: offsets (23 × 3) and soles, in cm.
 * @param {object} read result of readCharacter @param {object} joints of findJoints @param {object} tables of on_rig.py's rig_tables
 */
export function rigOf(read, joints, tables) {
  const objects = joints.nodes.map((node) => read.nodes[node]);
  for (const scene of read.scenes) scene.updateMatrixWorld(true);
  if (objects.some(({ matrixWorld }) => !(matrixWorld.determinant() > 0))) throw new Error("it has mirrored or flat bones (negative scale or zero); apply the scale");
  const places = objects.map(({ matrixWorld }) => new Vector3().setFromMatrixPosition(matrixWorld));
  const rest = new RestPose(joints, places, mapJoints(joints, places.map((place) => place.toArray()), tables), tables);
  const { differences, map } = rest;
  if (!movesWith(read.scenes, objects[map.Hips])) throw new Error("no skin binds its meshes to its bones, so they would not move; rig it first (in Blender, Mixamo or Mesh2Motion)");
  const path = (joint) => (joint < 0 ? [] : [...path(joints.parents[joint]), joint]);
  const top = path(map.Hips).filter((joint) => Object.values(map).every((other) => path(other).includes(joint))).at(-1);
  const carriers = new Map(Object.entries(map).map(([name, joint]) => [joint, tables.names.indexOf(name)]));
  if (!carriers.has(top)) carriers.set(top, 0);
  const world = ({ matrixWorld }) => new Quaternion().setFromRotationMatrix(new Matrix4().extractRotation(matrixWorld));
  const drives = [...carriers].sort(([a], [b]) => a - b).map(([joint, carrier]) => {
    const { w, x, y, z } = differences[carrier].clone().invert().multiply(world(objects[joint]));
    return [joints.nodes[joint], carrier, w, x, y, z];
  });
  const twists = rest.twists(path, (joint, way) => rotated(world(objects[joint].parent).invert(), way).toArray());
  const bones = (chosen) => new Set(joints.nodes.flatMap((node, joint) => (chosen(path(joint)) ? [read.nodes[node]] : [])));
  const beside = skinBeside(read, bones((above) => !above.includes(top)), bones((above) => above.includes(map.LeftFoot) || above.includes(map.RightFoot)));
  const moving = !beside.any ? [[top, false]] : beside.ofFeet ? [[0, true], [top, false]] : [[0, false]];
  const moves = moving.map(([joint, under]) => [joints.nodes[joint], joints.nodes[map.Hips], 0, under]);
  const { raised, offsets, part, expected, standing } = rest.stand();
  const soles = solesOf(read, joints, rest, part);
  const lift = (soles ? soles.depth : standing) - expected;
  const data = { scale: rest.scale * CM, turn: [1, 0, 0, 0], drives, moves, twists, raised: raised.multiplyScalar(CM).toArray(), lift: [0, lift * CM, 0] };
  return { data, kernel: { offsets, soles: soles?.parts ?? [], floor: -lift }, map: Object.fromEntries(Object.entries(map).map(([name, joint]) => [name, joints.names[joint]])) };
}

// Whether a mesh moves with the hips, by a skin or as a part below them.
function movesWith(scenes, hips) {
  let found = false;
  for (const scene of scenes) scene.traverse((mesh) => (found ||= Boolean(mesh.isSkinnedMesh)));
  hips.traverse((mesh) => (found ||= Boolean(mesh.isMesh)));
  return found;
}

class RestPose {
  constructor(joints, places, map, tables) {
    Object.assign(this, { ...joints, places, map, tables });
    this.steps = joints.parents.map((parent, joint) => (parent < 0 ? new Vector3() : places[joint].clone().sub(places[parent])));
    this.children = joints.names.map((_, joint) => joints.parents.flatMap((parent, child) => (parent === joint ? [child] : [])));
    this.tiny = 1e-2 * Math.max(...this.steps.slice(1).map((step) => step.length()));
    this.offsets = tables.offsets.map((offset) => new Vector3(...offset));
    this.rest = [];
    tables.parents.forEach((parent, joint) => this.rest.push(parent < 0 ? new Vector3() : this.rest[parent].clone().add(this.offsets[joint])));
    this.bones = Object.fromEntries(tables.names.map((name) => [name, map[name] === undefined ? undefined : this.#bone(name)]));
    const lengths = ["LeftUpLeg", "LeftLeg", "RightUpLeg", "RightLeg"].map((name) => this.bones[name] ?? []);
    if (lengths.some((bone) => !bone.length)) throw new Error("a leg bone has no length");
    const [usual, own] = [0, 1].map((kind) => lengths.reduce((sum, bone) => sum + bone[kind].length(), 0));
    this.scale = usual / own; // cm per unit of the file, with canonical legs
    this.frame = this.#frame();
    if (!this.#stands()) throw new Error("its rest pose is no standing person");
    this.differences = [];
    tables.names.forEach((name, joint) => this.differences.push(this.#difference(name, joint)));
  }

  at(name) {
    return this.map[name] === undefined ? undefined : this.places[this.map[name]];
  }

  // The bone of a joint, canonical and own; undefined if it has no end.
  #bone(name) {
    const { tables, places, map, rest } = this;
    const own = tables.names.indexOf(name);
    for (const ahead of tables.ahead[name] ?? []) {
      const way = this.at(ahead)?.clone().sub(places[map[name]]);
      if (way?.length() > this.tiny) return [rest[tables.names.indexOf(ahead)].clone().sub(rest[own]), way];
    }
    const end = tables.tops.includes(name) ? this.#headEnd(map[name]) : this.#boneEnd(map[name]);
    const usual = tables.ends[own] ? new Vector3(...tables.ends[own]) : this.offsets[tables.parents.indexOf(own)];
    return end && [usual, end];
  }

  #boneEnd(joint) {
    const ends = [];
    for (const child of this.children[joint]) {
      const step = this.steps[child];
      if (/thumb/i.test(this.names[child])) continue;
      const further = step.length() > this.tiny ? new Vector3() : this.#boneEnd(child);
      if (further) ends.push(step.clone().add(further));
    }
    return ends.length ? ends.reduce((sum, end) => sum.add(end), new Vector3()).divideScalar(ends.length) : undefined;
  }

  #headEnd(joint) {
    const { tables, places, parents, tiny } = this;
    let below = parents[joint];
    while (below >= 0 && places[joint].distanceTo(places[below]) <= tiny) below = parents[below];
    let [best, least] = [undefined, tables.alongNeck];
    for (const child of this.children[joint]) {
      const step = this.steps[child];
      if (new RegExp(tables.faceWords, "i").test(this.names[child]) || step.length() <= tiny) continue;
      if (new RegExp(tables.topWords, "i").test(this.names[child])) return step;
      const off = below < 0 ? Infinity : angle(places[joint].clone().sub(places[below]), step);
      if (off <= least) [best, least] = [step, off];
    }
    return best;
  }

  // The orientation of the body, snapped to the axes if near them.
  #frame() {
    const [left, right, leftArm, rightArm] = ["LeftUpLeg", "RightUpLeg", "LeftArm", "RightArm"].map((name) => this.at(name));
    const y = leftArm.clone().add(rightArm).sub(left).sub(right).normalize();
    const x = left.clone().sub(right).projectOnPlane(y).normalize();
    const axes = [x, y, x.clone().cross(y)].map((axis) => axis.toArray());
    const snapped = axes.map((axis) => axis.map(Math.round));
    const sums = [0, 1, 2].map((row) => snapped.reduce((sum, axis) => sum + Math.abs(axis[row]), 0));
    const near = axes.flat().every((value, n) => Math.abs(value - snapped.flat()[n]) < 0.35);
    const kept = near && sums.every((sum) => sum === 1) ? snapped : axes;
    return new Quaternion().setFromRotationMatrix(new Matrix4().makeBasis(...kept.map((axis) => new Vector3(...axis))));
  }

  #stands() {
    const limits = [["LowerBack", UP, 60], ["Spine", UP, 60]];
    for (const [side, sign] of [["Left", 1], ["Right", -1]]) {
      const [down, outward] = [UP.clone().negate(), new Vector3(sign, 0, 0)];
      limits.push([`${side}UpLeg`, down, 60], [`${side}Leg`, down, 60], [`${side}Arm`, outward, 105], [`${side}ForeArm`, outward, 120]);
    }
    return limits.every(([name, way, limit]) => !this.bones[name] || angle(rotated(this.frame, way), this.bones[name][1]) <= limit);
  }

  // The rotation from canonical to own rest directions of a joint.
  #difference(name, joint) {
    const { tables, frame, bones, differences } = this;
    const part = name.replace(/^(Left|Right)/, "");
    const above = differences[tables.parents[joint]];
    const bone = bones[name];
    if (part === "ToeBase") return above;
    if (part === "Foot") {
      const toe = bones[name.replace("Foot", "ToeBase")];
      if (!bone) return this.#foot(name, this.offsets[joint + 1], rotated(frame, AHEAD));
      return this.#foot(name, ...(toe && this.#under(bone[1], toe[1]) ? toe : bone));
    }
    if (tables.limbs.includes(part) || part === "Hand") return this.#turned(part === "Arm" ? frame : above, bone, part === "Hand" ? tables.tolerance.Hand : 0);
    const left = rotated(frame, new Vector3(1, 0, 0));
    const aside = tables.tops.includes(name) && bone && Math.abs(bone[1].clone().normalize().dot(left)) > tables.aside;
    return name === "Hips" || aside ? frame : this.#turned(frame, bone, tables.tolerance[part] ?? tables.elsewhere);
  }

  #under(foot, toe) {
    const [down, ahead] = [foot, toe].map((way) => rotated(this.frame.clone().invert(), way).normalize());
    return down.y < -this.tables.steep && Math.abs(ahead.y) < 1 - this.tables.steep;
  }

  #turned(base, bone, tolerance) {
    if (!bone) return base;
    const usual = rotated(base, bone[0]);
    const off = angle(usual, bone[1]);
    if (off <= tolerance || (tolerance > 0 && off > this.tables.noPosture)) return base;
    return new Quaternion().setFromUnitVectors(usual.normalize(), bone[1].clone().normalize()).multiply(base);
  }

  // Only heading and roll of a foot count, because it stands flat.
  #foot(name, usual, bone) {
    const { frame, tables } = this;
    const back = frame.clone().invert();
    const own = rotated(back, bone);
    const pitch = DEGREES * Math.asin(-own.y / own.length());
    if (!(pitch > -30 && pitch < 70)) return this.#turned(frame, [usual, bone], 0);
    const spread = ({ x, y }) => Math.atan2(x, -y);
    const heading = ({ x, z }) => Math.atan2(x, z);
    const [hip, ankle] = [name.replace("Foot", "UpLeg"), name].map((joint) => ({ own: this.at(joint), usual: this.rest[tables.names.indexOf(joint)] }));
    const roll = spread(rotated(back, ankle.own.clone().sub(hip.own))) - spread(ankle.usual.clone().sub(hip.usual));
    const flat = new Quaternion().setFromAxisAngle(AHEAD, Math.abs(roll) < radians(5) ? 0 : roll);
    const yaw = heading(own) - heading(rotated(flat, usual));
    if (Math.abs(yaw) > radians(15)) flat.premultiply(new Quaternion().setFromAxisAngle(UP, yaw));
    return product(frame, flat);
  }

  /** The limb bones with twist joints, as twist.py; axis turns a direction into the axes of a joint's parent. */
  twists(path, axis) {
    const { nodes, names, parents, places, map, tables } = this;
    const out = [];
    for (const [name, end] of Object.entries(map)) {
      const [, side, below] = /^(Left|Right)(.+)/.exec(name) ?? [];
      const part = Object.keys(tables.twistBones).find((one) => tables.twistBones[one] === below);
      const top = map[side + part];
      if (top === undefined || !path(end).includes(top)) continue;
      const bone = places[end].clone().sub(places[top]);
      const size = bone.length();
      const way = bone.clone().normalize();
      const chain = path(end).slice(path(end).indexOf(top) + 1, -1);
      const along = (joint) => places[joint].clone().sub(places[top]);
      const isTwist = (joint) => [top, ...chain].includes(parents[joint]) && tables.twistWords.some((word) => names[joint].toLowerCase().includes(word));
      const beside = names.flatMap((_, joint) => (isTwist(joint) && !Object.values(map).some((other) => path(other).includes(joint)) ? [joint] : []));
      const upper = part === "Arm" || part === "UpLeg";
      const straight = chain.length && chain.every((joint) => along(joint).projectOnPlane(way).length() <= tables.twistStraight * size);
      if (!size || !(beside.length || straight)) continue;
      const share = (joint) => (beside.length ? Math.min(1, Math.max(0, along(joint).dot(way) / size)) - upper : 1 / chain.length);
      const source = beside.length && !upper ? end : top;
      const shares = (beside.length ? beside : chain).map((joint) => [nodes[joint], share(joint), ...axis(joint, way)]);
      out.push({ node: nodes[source], axis: axis(source, way), taken: !beside.length, shares });
    }
    return out;
  }

  /** The body's offsets (cm, 23 × 3) raised to its feet, how far it was raised, and how high which part of standing feet is expected and is. */
  stand() {
    const { tables, offsets: usual } = this;
    const number = (name) => tables.names.indexOf(name);
    const body = tables.names.map((name, joint) => (joint ? this.#offset(name, joint) : new Vector3()));
    const mean = (offsets, part) => offsets[number(`Left${part}`)].clone().add(offsets[number(`Right${part}`)]).divideScalar(2);
    const higher = Math.max(0, mean(usual, "ToeBase").y - mean(body, "ToeBase").y);
    const raised = mean(usual, "UpLeg").sub(mean(body, "UpLeg")).add(new Vector3(0, higher, 0));
    tables.parents.forEach((parent, joint) => parent === 0 && body[joint].add(raised));
    const part = ["LeftToeBase", "RightToeBase"].every((name) => this.at(name)) ? "ToeBase" : "Foot";
    const expected = part === "ToeBase" ? tables.standing.ToeBase : tables.standing.Foot + higher;
    const feet = ["Left", "Right"].flatMap((side) => this.at(side + part)?.y ?? []);
    const shown = Math.min(...feet) * this.scale;
    const [low, high] = tables.plausible[part];
    const height = feet.length === 2 && shown >= low && shown <= high ? shown : expected;
    const standing = Math.max(height, ...["Left", "Right"].map((side) => this.#depth(side, part)));
    return { offsets: Float32Array.from(body.flatMap((offset) => offset.toArray())), raised, part, expected, standing };
  }

  #offset(name, joint) {
    const { tables, map } = this;
    let above = tables.parents[joint];
    while (map[tables.names[above]] === undefined) above = tables.parents[above];
    const top = tables.names[above];
    const bone = this.bones[top];
    let place = this.at(name);
    if (!place && !tables.parents.includes(joint)) {
      if (!bone || name === "Head") return this.offsets[joint].clone();
      place = this.at(top).clone().add(bone[1]);
    }
    return place ? rotated(this.differences[above].clone().invert(), place.clone().sub(this.at(top))).multiplyScalar(this.scale) : new Vector3();
  }

  // The depth of a flat foot below its toe or ankle, in cm.
  #depth(side, part) {
    const [foot, joint] = [this.map[`${side}Foot`], this.map[side + part]];
    if (foot === undefined || joint === undefined) return 0;
    const flat = this.differences[this.tables.names.indexOf(`${side}Foot`)].clone().invert();
    const below = [];
    const visit = (one) => [below.push(rotated(flat, this.places[one].clone().sub(this.places[joint])).y), this.children[one].forEach(visit)];
    visit(foot);
    return -Math.min(...below) * this.scale;
  }
}
