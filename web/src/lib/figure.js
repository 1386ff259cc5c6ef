// A figure in the scene: its body bends with the joints, and its skeleton can be shown through the body.

import {
  BufferAttribute, BufferGeometry, Bone, Color, Group, InstancedMesh, Matrix4, MeshBasicMaterial,
  MeshLambertMaterial, MeshStandardMaterial, OctahedronGeometry, Quaternion, SRGBColorSpace, Skeleton, SkinnedMesh, Sphere, SphereGeometry, Vector3,
} from "three";

const SIDE_COLORS = { left: 0x3b82f6, right: 0xf97316, "": 0xa8a29e };
const BEHIND = 0.22; // opacity of a body while its skeleton is visible

const matrix = new Matrix4();
const place = new Vector3();
const tip = new Vector3();
const turn = new Quaternion();
const size = new Vector3();
const spare = new Color();
const UP = new Vector3(0, 1, 0);

export class Figure extends Group {
  /**
   * @param {import("./rig.js").Rig} rig
   * @param {Color} color
   * @param {boolean} plain simpler drawing without a graphics card
   * @param {import("./hero.js").Hero} hero a user's character in place of the rig's body, or null
   */
  constructor(rig, color, plain = false, hero = null) {
    super();
    Object.assign(this, { rig, hero });
    const Material = plain ? MeshLambertMaterial : MeshStandardMaterial;
    this.material = new Material({ vertexColors: true });
    if (!plain) this.material.roughness = 0.58;
    if (!hero) this.mesh = this.#body();
    this.add(hero ?? this.mesh);
    this.bones = this.#skeleton();
    this.add(this.bones);
    this.color = color;
  }

  set color(color) {
    if (this.hero) return; // it has its own
    const { regions, shades } = this.rig.body;
    const mixed = shades.map(([r, g, b, share]) => color.clone().lerp(spare.setRGB(r / 255, g / 255, b / 255, SRGBColorSpace), share));
    const colors = this.mesh.geometry.getAttribute("color");
    regions.forEach((region, i) => mixed[region].toArray(colors.array, i * 3));
    colors.needsUpdate = true;
  }

  set skeletonShown(shown) {
    this.bones.visible = shown;
    if (this.hero) this.hero.opacity = shown ? BEHIND : 1;
    this.material.transparent = shown;
    this.material.opacity = shown ? BEHIND : 1;
    this.material.depthWrite = !shown;
    this.material.needsUpdate = true;
  }

  /** @param {import("./rig.js").Pose} pose */
  setPose(pose) {
    if (this.hero) this.hero.setPose(pose);
    this.skeleton?.bones.forEach((bone, j) => {
      bone.matrixWorld.compose(pose.places[j], pose.rotations[j], size.set(1, 1, 1));
    });
    if (this.bones.visible) this.#setSkeleton(pose);
  }

  #body() {
    const { body, count } = this.rig;
    const points = Float32Array.from(body.points, (step) => step / body.steps);
    const weights = Float32Array.from(body.weights, (step) => step / 255);
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(points, 3));
    geometry.setAttribute("skinIndex", new BufferAttribute(body.joints, 4));
    geometry.setAttribute("skinWeight", new BufferAttribute(weights, 4));
    geometry.setAttribute("color", new BufferAttribute(new Float32Array(points.length), 3));
    geometry.setIndex(new BufferAttribute(body.triangles, 1));
    geometry.setAttribute("normal", new BufferAttribute(Float32Array.from(body.normals, (step) => step / 127), 3));
    const bones = Array.from({ length: count }, () => Object.assign(new Bone(), { matrixAutoUpdate: false }));
    const inverses = bones.map((_, j) => {
      const [w, x, y, z] = body.rotations.subarray(j * 4, j * 4 + 4);
      return new Matrix4()
        .compose(place.fromArray(body.places, j * 3), turn.set(x, y, z, w), size.set(1, 1, 1))
        .invert();
    });
    this.skeleton = new Skeleton(bones, inverses);
    const mesh = new SkinnedMesh(geometry, this.material);
    mesh.normalizeSkinWeights(); // they were quantized
    mesh.bindMode = "detached"; // bones are positioned in the figure's own space
    mesh.bind(this.skeleton, new Matrix4());
    mesh.castShadow = true;
    mesh.frustumCulled = false;
    mesh.boundingSphere = new Sphere(); // avoids computing one from all points, which nothing needs
    return mesh;
  }

  #skeleton() {
    const { rig } = this;
    const group = new Group();
    const ball = new SphereGeometry(1, 10, 8);
    const stick = new OctahedronGeometry(1);
    stick.scale(1, 0.5, 1).translate(0, 0.5, 0);
    const material = new MeshBasicMaterial({ depthTest: false, transparent: true });
    this.joints = new InstancedMesh(ball, material, rig.count);
    this.links = [...rig.bones.map((joint) => [rig.parents[joint], joint, null]), ...rig.ends.map(([j, ...end]) => [j, null, end])];
    this.sticks = new InstancedMesh(stick, material, this.links.length);
    const color = (joint) => new Color(SIDE_COLORS[rig.sides[joint]]);
    for (let j = 0; j < rig.count; j++) this.joints.setColorAt(j, color(j));
    this.links.forEach(([parent, joint], n) => this.sticks.setColorAt(n, color(joint ?? parent)));
    for (const mesh of [this.sticks, this.joints]) {
      mesh.frustumCulled = false;
      mesh.renderOrder = 2;
      group.add(mesh);
    }
    group.visible = false;
    return group;
  }

  #setSkeleton(pose) {
    const thick = this.rig.stature * 0.009;
    for (let j = 0; j < this.rig.count; j++) {
      matrix.makeScale(thick, thick, thick).setPosition(pose.places[j]);
      this.joints.setMatrixAt(j, matrix);
    }
    this.links.forEach(([parent, joint, offset], n) => {
      if (joint === null) pose.carry(parent, tip.fromArray(offset));
      else tip.copy(pose.places[joint]);
      tip.sub(pose.places[parent]);
      const length = tip.length();
      turn.setFromUnitVectors(UP, length > 1e-6 ? tip.divideScalar(length) : UP);
      matrix.compose(pose.places[parent], turn, size.set(0.9 * thick, Math.max(length, 1e-6), 0.9 * thick));
      this.sticks.setMatrixAt(n, matrix);
    });
    this.joints.instanceMatrix.needsUpdate = true;
    this.sticks.instanceMatrix.needsUpdate = true;
  }

  dispose() {
    this.hero?.dispose();
    this.mesh?.geometry.dispose();
    this.material.dispose();
    this.skeleton?.dispose();
    this.joints.geometry.dispose();
    this.joints.material.dispose();
    this.sticks.geometry.dispose();
    this.joints.dispose();
    this.sticks.dispose();
  }
}
