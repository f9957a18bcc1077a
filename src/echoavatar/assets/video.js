// A WHEP player: it shows the session named in the address (?session=NAME), or the newest one, and asks again when that
// ends. `view`, `character` and `background` are passed on; `token` is the server's.
"use strict";

const RETRY_MS = 2000;
const query = new URLSearchParams(location.search);
const picture = document.getElementById("picture");
const state = document.getElementById("state");
const sound = document.getElementById("sound");

sound.addEventListener("click", () => {
  picture.muted = false;
  sound.hidden = true;
});

function endpoint() {
  const session = query.get("session");
  const wishes = new URLSearchParams();
  for (const name of ["view", "character", "background"]) {
    if (query.has(name)) wishes.set(name, query.get(name));
  }
  const path = session ? `/v1/sessions/${encodeURIComponent(session)}/whep` : "/v1/whep";
  return wishes.size ? `${path}?${wishes}` : path;
}

function headers(more) {
  const token = query.get("token");
  return token ? { ...more, authorization: `Bearer ${token}` } : more;
}

// All candidates in one offer: the server takes no more of them later.
async function gathered(peer) {
  await peer.setLocalDescription(await peer.createOffer());
  if (peer.iceGatheringState === "complete") return peer.localDescription.sdp;
  await new Promise((done) => {
    peer.addEventListener("icegatheringstatechange", () => peer.iceGatheringState === "complete" && done());
    setTimeout(done, 1000);
  });
  return peer.localDescription.sdp;
}

async function watch() {
  const peer = new RTCPeerConnection();
  const stream = new MediaStream();
  for (const kind of ["video", "audio"]) peer.addTransceiver(kind, { direction: "recvonly" });
  peer.addEventListener("track", (event) => {
    stream.addTrack(event.track);
    picture.srcObject = stream;
  });
  const ended = new Promise((done) => {
    peer.addEventListener("connectionstatechange", () => {
      if (peer.connectionState === "connected") {
        state.textContent = "Live";
        sound.hidden = !picture.muted;
      }
      if (["failed", "closed", "disconnected"].includes(peer.connectionState)) done();
    });
  });
  try {
    const body = await gathered(peer);
    const answer = await fetch(endpoint(), { method: "POST", body, headers: headers({ "content-type": "application/sdp" }) });
    if (answer.status !== 201) {
      const text = await answer.json().then((told) => told.error, () => answer.statusText);
      state.textContent = answer.status === 404 ? "Waiting for a session" : text;
      return;
    }
    const viewer = answer.headers.get("location");
    const leave = () => fetch(viewer, { method: "DELETE", keepalive: true, headers: headers({}) });
    addEventListener("pagehide", leave);
    await peer.setRemoteDescription({ type: "answer", sdp: await answer.text() });
    await ended;
    removeEventListener("pagehide", leave);
    state.textContent = "Connecting";
  } finally {
    peer.close();
  }
}

async function run() {
  for (;;) {
    await watch().catch((error) => (state.textContent = String(error.message || error)));
    await new Promise((done) => setTimeout(done, RETRY_MS));
  }
}

run();
