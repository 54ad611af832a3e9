// SPDX-License-Identifier: Apache-2.0
"use strict";
const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
let view = null; // the map from above
let turn = 0; // of the photo that is asked about; answers to earlier ones are dropped
let stream = null;

function say(text, kind = "") {
  $("status").textContent = text;
  $("status").className = kind;
}

async function ask(path, options = {}) {
  const token = $("token").value.trim();
  const headers = token ? { Authorization: "Bearer " + token } : {};
  let answer;
  try {
    answer = await fetch(path, { ...options, headers });
  } catch {
    throw new Error("The service cannot be reached.");
  }
  if (answer.ok) return answer;
  let detail = "The service failed (" + answer.status + ").";
  try { detail = (await answer.json()).detail || detail; } catch { /* no problem JSON */ }
  if (answer.status === 401) {
    $("more").open = true;
    detail = "This service needs its token: write it below.";
  }
  throw new Error(detail);
}

const address = (what) => "v1/maps/" + encodeURIComponent($("map").value) + "/" + what;

async function loadMaps() {
  const maps = await (await ask("v1/maps")).json();
  const options = maps.map((map) => new Option(map.name, map.name));
  if (maps.length > 1) options.unshift(new Option("any map", ""));
  $("map").replaceChildren(...options);
  $("map-label").hidden = maps.length < 2;
  await loadView();
}

async function loadView() {
  view = null;
  $("above").hidden = true;
  if (!$("map").value) return;
  const loaded = await (await ask(address("above"))).json();
  $("drawing").innerHTML = loaded.drawing; // of the server itself
  $("caption").textContent = "Seen from above; grey: reference photos.";
  $("above").hidden = false;
  view = loaded;
}

function showPlace(matrix, camera) {
  $("here")?.remove();
  if (!matrix || !view) return;
  const P = view.pixel_from_world;
  const [R, t] = [matrix.map((row) => row.slice(0, 3)), matrix.map((row) => row[3])];
  const centre = [0, 1, 2].map((i) => -(R[0][i] * t[0] + R[1][i] * t[1] + R[2][i] * t[2]));
  const dot = (row, v) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2];
  let [x, y] = P.map((row) => dot(row, centre) + row[3]);
  x = Math.min(Math.max(x, 0), view.width);
  y = Math.min(Math.max(y, 0), view.height);
  const group = document.createElementNS(SVG, "g");
  group.id = "here";
  const [dx, dy] = P.map((row) => dot(row, R[2]));
  const length = Math.hypot(dx, dy);
  const scale = Math.hypot(P[0][0], P[0][1], P[0][2]);
  if (length > 0.15 * scale) { // not where it looks up or down
    const words = camera.split(" ");
    const half = Math.atan(Number(words[1]) / 2 / Number(words[3])) || 0.5;
    const angle = Math.atan2(dy, dx), far = 150;
    const corner = (a) => (x + far * Math.cos(a)).toFixed(1) + " " + (y + far * Math.sin(a)).toFixed(1);
    const cone = document.createElementNS(SVG, "path");
    cone.setAttribute("class", "cone");
    cone.setAttribute("d", `M${x} ${y}L${corner(angle - half)}L${corner(angle + half)}Z`);
    group.append(cone);
  }
  const circle = document.createElementNS(SVG, "circle");
  for (const [name, value] of [["cx", x], ["cy", y], ["r", 16]]) circle.setAttribute(name, value);
  group.append(circle);
  $("drawing").querySelector("svg").append(group);
}

function showFacts(rows) {
  $("facts").replaceChildren(...rows.filter(([, text]) => text).flatMap(([name, text]) => {
    const [dt, dd] = [document.createElement("dt"), document.createElement("dd")];
    dt.textContent = name;
    dd.textContent = text;
    return [dt, dd];
  }));
}

// Whole numbers stay; others get so many decimals.
function rounded(text, decimals) {
  return (text || "").replace(/-?\d+\.\d+(e-?\d+)?/g, (word) => Number(word).toFixed(decimals));
}

function sigmas(covariance) {
  if (!covariance) return "";
  const d = covariance.map((row, i) => Math.sqrt(row[i]));
  const length = Math.hypot(d[0], d[1], d[2]);
  const degrees = Math.hypot(d[3], d[4], d[5]) * 180 / Math.PI;
  const unit = view?.metres_per_unit;
  const size = unit ? (100 * unit * length).toPrecision(2) + " cm, " : length.toPrecision(2) + " units, ";
  return size + degrees.toPrecision(2) + "°";
}

async function showRender(answer, mine) {
  const query = new URLSearchParams({ camera: answer.camera, cam_from_world: answer.cam_from_world });
  const picture = await (await ask(address("render?" + query))).blob();
  if (mine !== turn) return;
  URL.revokeObjectURL($("render").src);
  $("render").src = URL.createObjectURL(picture);
}

function showAnswer(answer) {
  const found = answer.status === "localized";
  say(found ? "Found." : "Not found: " + answer.reason, found ? "good" : "bad");
  showPlace(answer.matrix, answer.camera || "");
  showFacts([
    ["Pose", rounded(answer.cam_from_world, 4)],
    ["Standard deviations", sigmas(answer.covariance)],
    ["Began at", answer.reference],
    ["Camera", rounded(answer.camera, 1)],
    ["Seconds", answer.seconds.total === undefined ? "" : answer.seconds.total.toFixed(2)],
  ]);
  return found;
}

// Asks where a picture was taken; where any map may show it, the one that does is shown.
async function find(picture, name) {
  if (!$("map").options.length) await loadMaps();
  const form = new FormData();
  form.append("photo", picture, name);
  if ($("camera").value.trim()) form.append("camera", $("camera").value);
  const path = $("map").value ? address("localize") : "v1/localize";
  const answer = await (await ask(path, { method: "POST", body: form })).json();
  if (answer.map_name && answer.status === "localized") $("map").value = answer.map_name;
  if (!view) await loadView();
  return answer;
}

async function localize(file) {
  stopLive();
  const mine = ++turn;
  URL.revokeObjectURL($("photo").src);
  $("photo").src = URL.createObjectURL(file);
  $("photo").hidden = false;
  $("render").removeAttribute("src");
  $("pictures").hidden = false;
  showFacts([]);
  showPlace(null);
  say("Looking for the place …", "busy");
  try {
    const answer = await find(file, file.name || "photo.jpg");
    if (mine !== turn) return;
    if (showAnswer(answer)) await showRender(answer, mine);
  } catch (error) {
    if (mine === turn) say(error.message, "bad");
  }
}

function stopLive() {
  if (!stream) return;
  stream.getTracks().forEach((track) => track.stop());
  stream = null;
  $("video").hidden = true;
  $("live").textContent = "Live camera";
}

async function frameOf(video, canvas) {
  const shrink = Math.min(1, 640 / Math.max(video.videoWidth, video.videoHeight));
  canvas.width = Math.round(shrink * video.videoWidth);
  canvas.height = Math.round(shrink * video.videoHeight);
  canvas.getContext("2d").drawImage(video, 0, 0, canvas.width, canvas.height);
  return new Promise((done) => canvas.toBlob(done, "image/jpeg", 0.85));
}

async function live() {
  if (stream) { ++turn; stopLive(); say(""); return; }
  const mine = ++turn;
  try {
    stream = await navigator.mediaDevices.getUserMedia({ video: { facingMode: "environment" } });
    const video = $("video"), canvas = document.createElement("canvas");
    video.srcObject = stream;
    await video.play();
    $("live").textContent = "Stop";
    $("photo").hidden = true;
    video.hidden = false;
    $("pictures").hidden = false;
    let answer = null;
    while (mine === turn && (!answer || answer.status !== "localized")) {
      if (!answer) say("Looking for the place …", "busy");
      answer = await find(await frameOf(video, canvas), "frame.jpg");
      if (mine === turn && showAnswer(answer)) await showRender(answer, mine);
    }
    if (mine === turn) await track(answer.camera, video, canvas, mine);
  } catch (error) {
    if (mine === turn) { stopLive(); say(error.message, "bad"); }
  }
}

// Of a camera that is followed, now and then: each render takes a worker's time. Where the service
// is busy, the next one will do.
let rendering = false;
function renderAlong(answer, camera, mine) {
  if (rendering || !answer.matrix) return;
  rendering = true;
  showRender({ camera, cam_from_world: answer.cam_from_world }, mine).catch(() => {})
    .finally(() => setTimeout(() => { rendering = false; }, 1000));
}

function track(camera, video, canvas, mine) {
  return new Promise((done, fail) => {
    const url = new URL(address("track"), location.href);
    url.protocol = url.protocol.replace("http", "ws");
    const socket = new WebSocket(url);
    socket.onopen = () => {
      const token = $("token").value.trim();
      socket.send(JSON.stringify(token ? { camera, token } : { camera }));
    };
    socket.onmessage = async (event) => {
      const answer = JSON.parse(event.data);
      if (answer.detail) { fail(new Error(answer.detail)); return; }
      if (mine !== turn || !stream) { socket.close(); done(); return; }
      if (answer.status !== "ready") {
        const found = Boolean(answer.matrix);
        say(found ? "Following the camera." : "Lost: " + answer.reason, found ? "good" : "bad");
        showPlace(answer.matrix, camera);
        renderAlong(answer, camera, mine);
        showFacts([["Pose", rounded(answer.cam_from_world, 4)], ["Standard deviations", sigmas(answer.covariance)],
          ["Milliseconds", String(answer.milliseconds ?? "")]]);
      }
      socket.send(await (await frameOf(video, canvas)).arrayBuffer());
    };
    socket.onclose = () => { if (mine === turn && stream) fail(new Error("The connection ended.")); done(); };
  });
}

for (const id of ["take", "choose"]) {
  $(id).addEventListener("change", () => {
    const file = $(id).files[0];
    if (file) localize(file);
    $(id).value = "";
  });
}
$("map").addEventListener("change", () => loadView().catch((error) => say(error.message, "bad")));
$("token").addEventListener("change", () => {
  sessionStorage.setItem("gscpe-token", $("token").value);
  loadMaps().then(() => say("")).catch((error) => say(error.message, "bad"));
});
$("token").value = sessionStorage.getItem("gscpe-token") || "";
$("photo").addEventListener("error", () => { $("photo").alt = "This browser cannot show the photo."; });
$("live").hidden = !navigator.mediaDevices?.getUserMedia;
$("live").addEventListener("click", live);
loadMaps().catch((error) => say(error.message, "bad"));
