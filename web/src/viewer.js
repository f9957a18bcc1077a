// The clip viewer: plays the animations of one GLB with their sound. The audio element is the only clock.
import * as THREE from "three";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import { filmHair } from "../packages/client/src/drivers/light.ts";
import { makeViewport } from "./viewport.js";

const ICONS = { play: "M5 2.5v15l12-7.5z", pause: "M4 3h4.5v14H4zM11.500 3H16v14h-4.500z" };
const element = (id) => document.getElementById(id);
const clock = (s) => `${Math.floor(s / 60)}:${String(Math.floor(s % 60)).padStart(2, "0")}`;

async function start() {
  const data = JSON.parse(element("data").textContent);
  const low = new URLSearchParams(location.search).get("quality") === "low";
  const canvas = document.createElement("canvas");
  document.body.prepend(canvas);
  const viewport = makeViewport(canvas, low);
  const gltf = await new GLTFLoader().parseAsync(bytes(data.glb).buffer, "");
  viewport.scene.add(gltf.scene);
  viewport.light.stand(gltf.scene);
  const bones = {};
  const faces = []; // meshes with blendshapes, driven by the weights of the clips
  gltf.scene.traverse((node) => {
    if (node.isBone) bones[node.name] = node;
    if (node.morphTargetInfluences) faces.push(node);
    if (!node.isSkinnedMesh) return;
    node.material = filmHair(node.material);
    Object.assign(node, { castShadow: true, receiveShadow: !low, frustumCulled: false });
  });
  const mixer = new THREE.AnimationMixer(gltf.scene);
  const player = makePlayer(data.clips, gltf.animations, mixer);
  connectControls(viewport, player, data.clips);
  let first = true;
  const draw = () => {
    player.pose();
    bones.hips.getWorldPosition(here);
    viewport.follow(here.x, here.z, first ? 1 : 0.06);
    if (first) viewport.frame();
    first = false;
    viewport.render();
  };
  const here = new THREE.Vector3();
  // Draw only after a change, so that an idle page costs nothing.
  let drawn = "";
  const loop = () => {
    const state = `${player.audio.currentTime} ${player.current} ${viewport.version()}`;
    if (state !== drawn) draw();
    drawn = state;
    player.show();
    requestAnimationFrame(loop);
  };
  viewport.resize();
  loop();
  return { player, viewport, bones, faces, draw, THREE };
}

function makePlayer(clips, animations, mixer) {
  const audio = new Audio();
  audio.preload = "auto";
  let length = 0;
  let action = null;
  const player = {
    audio,
    current: -1,
    // the sound's length if known, else the motion's
    duration: () => (Number.isFinite(audio.duration) && audio.duration > 0 ? audio.duration : length),
    choose(index) {
      player.current = index;
      const animation = animations.find((entry) => entry.name === clips[index].animation);
      length = animation.duration;
      if (action) action.stop();
      action = mixer.clipAction(animation).setLoop(THREE.LoopOnce);
      action.clampWhenFinished = true;
      action.play();
      audio.src = clips[index].audio;
    },
    pose() {
      action.paused = false;
      action.enabled = true;
      action.time = 0;
      mixer.time = 0;
      mixer.update(Math.min(audio.currentTime, length - 1e-4));
    },
    toggle() {
      if (audio.paused) return audio.play();
      audio.pause();
      return Promise.resolve();
    },
    seek(seconds) {
      audio.currentTime = Math.max(0, Math.min(seconds, player.duration() - 0.01));
    },
    show: () => {},
  };
  return player;
}

function connectControls(viewport, player, clips) {
  const { audio } = player;
  const [scrub, play, begin] = [element("scrub"), element("play"), element("start")];
  const choices = clips.map((clip, index) => {
    const button = document.createElement("button");
    button.textContent = clip.title;
    button.onclick = () => {
      select(index);
      audio.play();
    };
    element("clips").append(button);
    return button;
  });
  const pageNote = element("note").textContent;
  const select = (index) => {
    player.choose(index);
    choices.forEach((button, i) => button.setAttribute("aria-pressed", String(i === index)));
    element("note").textContent = clips[index].note || pageNote;
  };
  element("clips").hidden = clips.length < 2;
  play.onclick = begin.onclick = () => player.toggle();
  viewport.renderer.domElement.addEventListener("dblclick", () => viewport.frame());
  element("view").onclick = () => viewport.nextView();
  element("theme").onclick = () => setTheme(document.documentElement.dataset.theme !== "dark");
  scrub.oninput = () => player.seek(Number(scrub.value) * player.duration());
  const showState = () => {
    const icon = audio.paused ? "play" : "pause";
    play.querySelector("path").setAttribute("d", ICONS[icon]);
    play.setAttribute("aria-label", audio.paused ? "Play" : "Pause");
    if (!audio.paused) begin.hidden = true;
  };
  audio.onplay = audio.onpause = audio.onended = showState;
  audio.onerror = () => report("This browser cannot play the clip's sound format.");
  player.show = () => {
    const total = player.duration();
    if (document.activeElement !== scrub || !audio.paused) scrub.value = String(audio.currentTime / total || 0);
    element("time").textContent = `${clock(audio.currentTime)} / ${clock(total)}`;
  };
  window.addEventListener("keydown", (event) => {
    if (event.code === "Space" && event.target.tagName !== "BUTTON") {
      event.preventDefault();
      player.toggle();
    }
    if (event.target !== scrub && event.code === "ArrowLeft") player.seek(audio.currentTime - 2);
    if (event.target !== scrub && event.code === "ArrowRight") player.seek(audio.currentTime + 2);
  });
  window.addEventListener("resize", () => viewport.resize());
  const setTheme = (dark) => {
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    viewport.setTheme(dark);
  };
  setTheme(window.matchMedia("(prefers-color-scheme: dark)").matches);
  select(0);
}

function bytes(base64) {
  return Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
}

function report(text) {
  element("problem").textContent = text;
}

window.echoavatar = start();
window.echoavatar.catch((error) => {
  report(`The avatar could not be shown: ${error.message}`);
  console.error(error);
});
