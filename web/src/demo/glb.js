// Writes a recording as binary glTF: the body that the page draws, and its motion.

import { AnimationClip, Bone, Group, Matrix4, MeshStandardMaterial, QuaternionKeyframeTrack, Skeleton, SkinnedMesh, VectorKeyframeTrack } from "three";
import { GLTFExporter } from "three/examples/jsm/exporters/GLTFExporter.js";

const CM = 0.01;

/** The bytes of a .glb file. @param {import("../lib/figure.js").Figure} figure @param {{root: Float32Array, rotations: Float32Array}[]} frames in cm */
export async function glbBytes(figure, frames, fps) {
  const { rig } = figure;
  const bones = rig.names.map((name, joint) => {
    const bone = Object.assign(new Bone(), { name });
    bone.position.fromArray(rig.offsets, 3 * joint);
    return bone;
  });
  rig.parents.forEach((parent, joint) => parent >= 0 && bones[parent].add(bones[joint]));
  bones[0].position.fromArray(frames[0].root).multiplyScalar(CM);
  const mesh = new SkinnedMesh(figure.mesh.geometry, new MeshStandardMaterial({ vertexColors: true, roughness: 0.58, metalness: 0 }));
  mesh.name = "body";
  const whole = new Group().add(bones[0], mesh);
  whole.updateMatrixWorld(true);
  mesh.bind(new Skeleton(bones, figure.skeleton.boneInverses), new Matrix4());
  const times = frames.map((_, frame) => frame / fps);
  const tracks = rig.names.map((name, joint) => new QuaternionKeyframeTrack(`${name}.quaternion`, times, turns(frames, joint)));
  tracks.push(new VectorKeyframeTrack(`${rig.names[0]}.position`, times, frames.flatMap(({ root }) => Array.from(root, (cm) => cm * CM))));
  const animations = [new AnimationClip("recording", -1, tracks)];
  return new GLTFExporter().parseAsync(whole, { binary: true, animations });
}

// A joint's rotations x, y, z, w; of two equivalent quaternions, the one closer to the previous frame's.
function turns(frames, joint) {
  const out = [];
  for (const { rotations } of frames) {
    const [w, x, y, z] = rotations.subarray(4 * joint, 4 * joint + 4);
    const now = [x, y, z, w];
    const along = out.length ? now.reduce((sum, value, n) => sum + value * out.at(n - 4), 0) : 1;
    out.push(...now.map((value) => (along < 0 ? -value : value)));
  }
  return out;
}
