// Opens a .glb, or a .vrma on a .vrm avatar, with three.js; tests/export/test_readers.py calls open() and places().
import {
  AmbientLight, AnimationMixer, Box3, Color, DirectionalLight, GridHelper, PerspectiveCamera, Scene, Vector3, WebGLRenderer,
} from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { VRMLoaderPlugin } from "@pixiv/three-vrm";
import { VRMAnimationLoaderPlugin, createVRMAnimationClip } from "@pixiv/three-vrm-animation";

const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;

function load(text) {
  const loader = new GLTFLoader();
  loader.register((parser) => new VRMLoaderPlugin(parser));
  loader.register((parser) => new VRMAnimationLoaderPlugin(parser));
  return loader.parseAsync(bytes(text), "");
}

let mixer, scene, vrm, root;

/** Loads a file (base64), a .vrma onto an avatar; returns what was found in it. */
async function open(file, avatar) {
  scene = new Scene();
  const gltf = await load(file);
  let clip = gltf.animations.at(-1); // what was added to a user's file
  vrm = null;
  if (avatar) {
    vrm = (await load(avatar)).userData.vrm;
    clip = createVRMAnimationClip(gltf.userData.vrmAnimations[0], vrm);
  }
  root = vrm ? vrm.scene : gltf.scene;
  scene.add(root);
  mixer = new AnimationMixer(root);
  mixer.clipAction(clip).play();
  const found = { bones: 0, skinned: 0, duration: clip.duration, tracks: clip.tracks.length };
  root.traverse((node) => {
    found.bones += node.isBone ? 1 : 0;
    found.skinned += node.isSkinnedMesh ? 1 : 0;
  });
  return found;
}

/** World positions of nodes, or of humanoid bones of an avatar, at a time in seconds. */
function places(time, names) {
  mixer.setTime(time);
  vrm?.update(0);
  scene.updateMatrixWorld(true);
  return names.map((name) => {
    const node = vrm ? vrm.humanoid.getRawBoneNode(name) : root.getObjectByName(name);
    return node.getWorldPosition(new Vector3()).toArray();
  });
}

/** Draws the figure at a time. */
function draw(time, hips) {
  const [[x, , z]] = places(time, [hips]);
  const renderer = new WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  renderer.setSize(innerWidth, innerHeight);
  document.body.replaceChildren(renderer.domElement);
  scene.background = new Color(0xeef1f5);
  const sun = new DirectionalLight(0xffffff, 2.2);
  sun.position.set(2, 5, 3);
  const grid = new GridHelper(20, 20, 0x99a3b0, 0xc8cfd8);
  grid.position.set(Math.round(x), 0, Math.round(z));
  scene.add(sun, new AmbientLight(0xffffff, 1.2), grid);
  const camera = new PerspectiveCamera(35, innerWidth / innerHeight, 0.1, 100);
  camera.position.set(x + 3.2, 1.6, z + 3.2);
  camera.lookAt(x, 0.9, z);
  root.traverse((node) => (node.frustumCulled = false));
  renderer.render(scene, camera);
  scene.remove(sun, grid);
  return new Box3().setFromObject(root).getSize(new Vector3()).toArray();
}

window.checks = { open, places, draw };
