// Writes a recording as binary glTF: the body that the page draws, and its motion.

import { AnimationClip, Bone, Group, Matrix4, MeshStandardMaterial, Quaternion, QuaternionKeyframeTrack, Skeleton, SkinnedMesh, VectorKeyframeTrack } from "three";
import { GLTFExporter } from "three/examples/jsm/exporters/GLTFExporter.js";

const CM = 0.01;

/** The bytes of a .glb file, with the bones of export/figure.py. @param {import("../lib/figure.js").Figure} figure @param {{root: Float32Array, rotations: Float32Array}[]} frames in cm */
export async function glbBytes(figure, frames, fps) {
  const { rig } = figure;
  const axes = rig.axes.map(([w, x, y, z]) => new Quaternion(x, y, z, w));
  const above = rig.parents.map((parent) => (parent < 0 ? new Quaternion() : axes[parent].clone().invert()));
  const bones = rig.names.map((name, joint) => {
    const bone = Object.assign(new Bone(), { name });
    bone.position.fromArray(rig.offsets, 3 * joint).applyQuaternion(above[joint]);
    bone.quaternion.copy(above[joint]).multiply(axes[joint]);
    return bone;
  });
  rig.parents.forEach((parent, joint) => parent >= 0 && bones[parent].add(bones[joint]));
  bones[0].position.set(0, rig.height, 0);
  const mesh = new SkinnedMesh(figure.mesh.geometry, new MeshStandardMaterial({ vertexColors: true, roughness: 0.58, metalness: 0 }));
  mesh.name = "body";
  const whole = new Group().add(bones[0], mesh);
  whole.updateMatrixWorld(true);
  const turned = figure.skeleton.boneInverses.map((inverse, joint) => inverse.clone().premultiply(new Matrix4().makeRotationFromQuaternion(axes[joint].clone().invert())));
  mesh.bind(new Skeleton(bones, turned), new Matrix4());
  const times = frames.map((_, frame) => frame / fps);
  const tracks = rig.names.map((name, joint) => new QuaternionKeyframeTrack(`${name}.quaternion`, times, turns(frames, joint, above[joint], axes[joint])));
  tracks.push(new VectorKeyframeTrack(`${rig.names[0]}.position`, times, frames.flatMap(({ root }) => Array.from(root, (cm) => cm * CM))));
  const animations = [new AnimationClip("recording", -1, tracks)];
  return new GLTFExporter().parseAsync(whole, { binary: true, animations });
}

// A joint's rotations x, y, z, w between two axes; of two equivalent quaternions, the one closer to the previous frame's.
function turns(frames, joint, above, axes) {
  const out = [];
  for (const { rotations } of frames) {
    const [w, x, y, z] = rotations.subarray(4 * joint, 4 * joint + 4);
    const now = new Quaternion(x, y, z, w).premultiply(above).multiply(axes).toArray();
    const along = out.length ? now.reduce((sum, value, n) => sum + value * out.at(n - 4), 0) : 1;
    out.push(...now.map((value) => (along < 0 ? -value : value)));
  }
  return out;
}
