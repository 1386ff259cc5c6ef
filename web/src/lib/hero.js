// A user's character in the scene: the meshes and bones of its own file, posed by the joints of a figure.

import { Group, Quaternion, Vector3 } from "three";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import { VRMLoaderPlugin } from "@pixiv/three-vrm";
import { toBindPose } from "./bind.js";

const turn = new Quaternion();
const place = new Vector3();
const mark = new Vector3();
const there = new Vector3();

// Unpacks meshes; what it needs is run only if a file has such.
const meshopt = {
  supported: true,
  decodeGltfBufferAsync: async (...packed) => {
    const { MeshoptDecoder } = await import("three/examples/jsm/libs/meshopt_decoder.module.js");
    await MeshoptDecoder.ready;
    return MeshoptDecoder.decodeGltfBufferAsync(...packed);
  },
};

/** What GLTFLoader makes of the bytes of a .glb or .vrm, and `nodes`, its objects by their numbers in the file. */
export async function readCharacter(bytes) {
  const loader = new GLTFLoader().setMeshoptDecoder(meshopt);
  loader.register((parser) => new VRMLoaderPlugin(parser, { autoUpdateHumanBones: false }));
  const read = await loader.parseAsync(bytes, "");
  // The toon shader of avatars works tangents out itself, and does not compile with those of a mesh.
  read.scene.traverse(({ geometry, material }) => [material].flat().some((one) => one?.isMToonMaterial) && geometry.deleteAttribute("tangent"));
  read.nodes = await Promise.all((read.parser.json.nodes ?? []).map((_, n) => read.parser.getDependency("node", n)));
  if (!String(read.asset?.generator).startsWith("motionkit ")) toBindPose(read.scenes);
  return read;
}

export class Hero extends Group {
  /** @param {object} read result of readCharacter; belongs to the hero from now on @param {object} data of character_data.py */
  constructor(read, { scale, turn, drives, moves, twists, raised, lift }) {
    super();
    Object.assign(this, { moves, twists, raised, lift, vrm: read.userData.vrm, nodes: read.nodes });
    this.add(read.scene);
    this.scale.setScalar(scale);
    this.quaternion.copy(quaternion(turn));
    this.worlds = new Map([[this, this.quaternion]]); // rotations in the figure's space
    const driven = new Map(drives.map(([node, joint, ...rest]) => [read.nodes[node], { joint, rest: quaternion(rest) }]));
    const needed = new Set();
    for (let node of driven.keys()) for (; node && node !== this && !needed.has(node); node = node.parent) needed.add(node);
    this.steps = [];
    this.looks = new Map();
    read.scene.traverse((node) => {
      if (needed.has(node)) this.steps.push({ node, world: new Quaternion(), ...driven.get(node) });
      if (!node.isMesh) return;
      Object.assign(node, { castShadow: true, frustumCulled: false });
      for (const one of [node.material].flat()) this.looks.set(one, { transparent: one.transparent, opacity: one.opacity, depthWrite: one.depthWrite });
    });
    for (const { node, world } of this.steps) this.worlds.set(node, world);
    this.rests = read.nodes.map((node) => node.quaternion.clone());
    this.places = new Map(moves.map(([node]) => [node, read.nodes[node].position.clone()]));
  }

  /** @param {import("./rig.js").Pose} pose */
  setPose({ rotations, places }) {
    for (const { node, joint, rest, world } of this.steps) {
      const outer = this.worlds.get(node.parent);
      if (joint === undefined) world.multiplyQuaternions(outer, node.quaternion);
      else {
        world.multiplyQuaternions(rotations[joint], rest);
        node.quaternion.copy(outer).invert().multiply(world);
      }
    }
    this.twists.forEach((twist) => this.#spread(twist));
    this.parent.updateWorldMatrix(true, false);
    for (const [node, rest] of this.places) this.nodes[node].position.copy(rest);
    for (const [node, marked, joint, under] of this.moves) {
      place.fromArray(this.raised).applyQuaternion(rotations[joint]);
      place.add(places[joint]).add(mark.fromArray(this.lift)).applyMatrix4(this.parent.matrixWorld);
      this.#move(this.nodes[node], this.nodes[marked], under);
    }
    if (this.vrm) this.#springs();
  }

  // The twist of a bone about its axis, in the axes of its parent, shared with other bones.
  #spread({ node, axis, taken, shares }) {
    const source = this.nodes[node];
    const away = turn.copy(this.rests[node]).invert().premultiply(source.quaternion);
    const angle = 2 * Math.atan2(mark.fromArray(axis).dot(away), away.w);
    const twisted = (share, way) => new Quaternion().setFromAxisAngle(mark.fromArray(way), share * Math.atan2(Math.sin(angle), Math.cos(angle)));
    if (taken) source.quaternion.copy(away).multiply(twisted(-1, axis)).multiply(this.rests[node]);
    for (const [other, share, ...way] of shares) this.nodes[other].quaternion.copy(twisted(share, way)).multiply(this.rests[other]);
  }

  // Moves a node so that another one is at `place` in the world, or under it: not down.
  #move(node, marked, under) {
    marked.updateWorldMatrix(true, false);
    mark.copy(place).sub(there.setFromMatrixPosition(marked.matrixWorld));
    if (under) mark.y = Math.max(0, mark.y);
    node.position.copy(node.parent.worldToLocal(mark.add(there.setFromMatrixPosition(node.matrixWorld))));
  }

  // Hair and clothes of an avatar go on by the time since the last picture.
  #springs() {
    const now = performance.now();
    const passed = Math.min(0.1, (now - (this.sprung ?? now)) / 1000);
    this.sprung = now;
    this.updateWorldMatrix(true, true);
    this.vrm.update(passed);
  }

  set opacity(opacity) {
    for (const [material, look] of this.looks) {
      Object.assign(material, look, opacity < 1 && { transparent: true, opacity, depthWrite: false }, { needsUpdate: true });
    }
  }

  dispose() {
    this.traverse(({ geometry, skeleton }) => [geometry, skeleton].forEach((one) => one?.dispose()));
    for (const material of this.looks.keys()) {
      for (const value of Object.values(material)) if (value?.isTexture) value.dispose();
      material.dispose();
    }
  }
}

const quaternion = ([w, x, y, z]) => new Quaternion(x, y, z, w);
