"use strict";
/* The labeling page: shows what the server says, and says what the operator chooses. */

const FACES = [["Left", ""], ["Front", ""], ["Right", ""], ["Top", "fingers left, right"], ["Top", "fingers near, far"]];
const FACE_WORDS = ["left", "front", "right", "top, fingers left and right", "top, fingers near and far"];
const FACE_COLORS = ["#0072b2", "#e69f00", "#cc79a7", "#009e73", "#56b4e9"];
const CATEGORIES = { green: ["safe", "#009e73", "●"], yellow: ["feasible", "#f0e442", "▲"], red: ["too close", "#d55e00", "■"] };
const PENDING = "boxgrasp-unsaved"; // a label that the server has not confirmed, kept over a reload
const RETRY_MS = 1000;

const at = (id) => document.getElementById(id);
let state = null; // as the server last told it
let mine = blank(); // what the operator chose of the scene that is shown
let busy = false;
let events = null;

function blank() { return { face: null, label: null, none: false, wrong: false, pixel: null }; }

/* Asks the server. A refusal is an Error with its status; a lost server has status 0. */
async function ask(path, body) {
  let answer, said = null;
  try {
    answer = await fetch(path, body === undefined ? { cache: "no-store" } : {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
    const text = await answer.text(); // which a server that is killed may cut off
    if (answer.ok) said = JSON.parse(text);
    else try { said = JSON.parse(text); } catch (error) { said = null; }
  } catch (error) {
    throw Object.assign(new Error("the server cannot be reached"), { status: 0 });
  }
  if (!answer.ok) {
    const words = said && typeof said.error === "string" ? said.error : `the server answered ${answer.status}`;
    throw Object.assign(new Error(words), { status: answer.status });
  }
  return said;
}

const wait = (ms) => new Promise((done) => setTimeout(done, ms));

function show(id, visible, text) {
  at(id).hidden = !visible;
  if (text !== undefined) at(id).textContent = text;
}

function notice(text) { show("notice", Boolean(text), text || ""); }

/* ---- the session ---- */

async function begin(operator) {
  localStorage.setItem("boxgrasp-operator", operator);
  const found = await ask("/api/session", { operator });
  const other = !state || state.session !== found.session;
  state = found;
  if (other) { openView(); openEvents(); }
  render(true);
}

function openView() {
  at("view").src = `/view/${state.session}/`;
  window.focus(); // else keys would go to a page that is not loaded yet
}

/* Keys work wherever the focus is, in the cloud's page too; its own controls do without them. */
function hearView() {
  const page = at("view").contentDocument;
  if (!page || page.hearsKeys) return;
  page.hearsKeys = true;
  page.addEventListener("keydown", (event) => { if (onKey(event)) event.stopImmediatePropagation(); }, true);
}

function openEvents() {
  if (events) events.close();
  events = new EventSource(`/api/events?session=${state.session}`);
  events.addEventListener("state", () => refresh());
  events.addEventListener("learning", () => refreshLearning());
  events.addEventListener("asks", (event) => {
    const count = Number(event.data);
    if (state) { state.asks = count; renderAsks(); }
  });
  events.addEventListener("choice", (event) => {
    const said = JSON.parse(event.data);
    if (said.serial !== state.serial) return;
    if (said.pixel && mine.wrong) mine.pixel = said.pixel;
    else if (!mine.wrong) Object.assign(mine, { face: said.face, label: said.label, none: false });
    renderChoice();
  });
  events.onerror = () => { if (events.readyState === EventSource.CLOSED) comeBack(); };
}

let returning = false;
/* After a lost server: wait for it, take up the session, then send what was not confirmed. */
async function comeBack() {
  if (returning) return;
  returning = true;
  while (true) {
    try {
      await begin(state ? state.operator : localStorage.getItem("boxgrasp-operator"));
      break;
    } catch (error) {
      const kept = localStorage.getItem(PENDING) ? " Your label is kept here and will be sent." : "";
      show("lost", true, (error.status ? error.message : "The server cannot be reached; trying again.") + kept);
      await wait(RETRY_MS);
    }
  }
  show("lost", false);
  returning = false;
  await sendPending();
}

async function refresh() {
  if (!state) return;
  const before = state.serial;
  try { state = await ask(`/api/state?session=${state.session}`); } catch (error) { return comeBack(); }
  render(state.serial !== before);
}

/* One of the steps that answer with the state. */
async function step(path, body) {
  if (busy || !state) return;
  busy = true;
  try {
    const before = state.serial;
    state = await ask(path, { session: state.session, ...body });
    render(state.serial !== before);
  } catch (error) {
    if (error.status === 0 || error.status === 404) comeBack(); else notice(error.message);
  } finally { busy = false; renderChoice(); }
}

/* ---- saving ---- */

async function save() {
  const shown = state && state.shown;
  if (busy || !shown || !ready()) return;
  const verdict = mine.none ? "none" : mine.wrong ? "box_wrong" : "candidate";
  const label = { label_id: shown.label_id, scene_key: shown.scene_key, verdict, note: at("note").value,
    label: verdict === "candidate" ? mine.label : null, pixel: mine.wrong ? mine.pixel : null };
  localStorage.setItem(PENDING, JSON.stringify({ operator: state.operator, label }));
  await sendPending();
}

async function sendPending() {
  const kept = localStorage.getItem(PENDING);
  if (!kept || !state) return;
  const pending = JSON.parse(kept);
  if (pending.operator !== state.operator) return;
  busy = true;
  at("save").disabled = true;
  try {
    const before = state.serial;
    state = await ask("/api/save", { session: state.session, ...pending.label });
    localStorage.removeItem(PENDING);
    render(state.serial !== before);
  } catch (error) {
    if (error.status === 0 || error.status === 404) { busy = false; return comeBack(); }
    localStorage.removeItem(PENDING);
    renderChoice();
    notice(`Not saved: ${error.message}`);
    if (error.status === 409) { busy = false; await refresh(); notice(`Not saved: ${error.message}`); }
  } finally { busy = false; renderChoice(); }
}

/* ---- choosing ---- */

function ready() { return mine.none || mine.wrong || mine.label !== null; }

let asked = 0;
function tellChoice(face, label) {
  const number = ++asked, serial = state.serial;
  // The last one wins: while keys come quickly, those between are not worth showing.
  setTimeout(() => {
    if (number !== asked || !state || state.serial !== serial) return;
    ask("/api/choose", { session: state.session, serial, face, label }).catch((error) => {
      if (error.status === 0 || error.status === 404) comeBack();
    });
  }, 0);
}

function choose(change) {
  if (!state || !state.shown) return;
  const wasWrong = mine.wrong;
  mine = { ...blank(), ...change };
  if (mine.wrong !== wasWrong) pick(mine.wrong);
  if (!mine.wrong) tellChoice(mine.face, mine.label);
  renderChoice();
}

function pick(on) {
  ask("/api/pick", { session: state.session, on }).catch(() => undefined);
}

const chooseFace = (face) => choose({ face });
const chooseLine = (line) => mine.face && choose({ face: mine.face, label: (mine.face - 1) * state.shown.lines + line });

function digit(number) {
  if (number === 0) return choose({ none: !mine.none });
  if (mine.face !== null && mine.label === null) {
    if (number <= state.shown.lines) chooseLine(number);
  } else if (number <= FACES.length) chooseFace(number);
}

function takeBack() {
  if (mine.label !== null) choose({ face: mine.face });
  else choose({});
}

function spotAt(event) {
  if (!mine.wrong || !state.shown.width_px) return;
  const place = imagePlace();
  const u = Math.floor((event.clientX - place.left) / place.width * state.shown.width_px);
  const v = Math.floor((event.clientY - place.top) / place.height * state.shown.height_px);
  if (u < 0 || v < 0 || u >= state.shown.width_px || v >= state.shown.height_px) return;
  mine.pixel = [u, v];
  renderChoice();
}

/* Where the picture lies on the page: `object-fit` leaves room beside it. */
function imagePlace() {
  const box = at("image").getBoundingClientRect();
  const wide = state.shown.width_px / state.shown.height_px;
  const width = Math.min(box.width, box.height * wide), height = width / wide;
  return { left: box.left + (box.width - width) / 2, top: box.top + (box.height - height) / 2, width, height };
}

/* ---- what is shown ---- */

function render(fresh) {
  const shown = state.shown, progress = state.progress;
  at("who").textContent = state.operator;
  const total = progress.scenes;
  at("where").textContent = shown ? (shown.number ? `${shown.number} of ${total}: ${shown.name}` : shown.name) : state.source;
  at("where").title = at("where").textContent;
  at("bar").firstElementChild.style.width = `${total ? 100 * progress.done / total : 0}%`;
  at("bar").setAttribute("aria-valuemax", total);
  at("bar").setAttribute("aria-valuenow", progress.done);
  const rate = progress.rate_per_hour === null ? "" : `, ${Math.round(progress.rate_per_hour)} an hour`;
  const left = progress.seconds_left === null ? "" : `, ${spell(progress.seconds_left)} left`;
  at("progress").textContent = `${progress.done} done, ${total - progress.done} left${rate}${left}`;
  notice(state.notice);
  renderAsks();
  at("work").hidden = !shown;
  show("empty", !shown, shown ? "" : state.skipped
    ? `Nothing is left but ${state.skipped} that you skipped. Press S to take them again.`
    : "Everything is labeled. Thank you! This page waits for the robot's questions.");
  if (shown && fresh) {
    mine = fromStanding(shown);
    at("note").value = shown.standing ? shown.standing.note : "";
    at("image").src = `/api/image?session=${state.session}&serial=${state.serial}`;
    if (shown.told === null) at("colors").setAttribute("aria-pressed", "false");
    if (shown.standing && mine.face) tellChoice(mine.face, mine.label);
  }
  if (shown) {
    at("colors").setAttribute("aria-pressed", String(shown.told !== null));
    const kinds = [shown.standing ? "You correct a label of your own." : "",
      shown.ask ? `The robot asks (${shown.ask.asker}): ${Math.max(0, Math.round(shown.ask.seconds_left))} s left.` : ""];
    show("kind", kinds.some(Boolean), kinds.filter(Boolean).join(" "));
    renderProposal(shown.proposal);
    renderFaces(shown);
  }
  renderChoice();
  document.body.dataset.serial = state.serial; // the page shows that scene now
  document.body.dataset.labels = state.labels;
}

function fromStanding(shown) {
  const had = shown.standing;
  if (had) {
    const face = had.label ? Math.ceil(had.label / shown.lines) : null;
    return { face, label: had.label, none: had.verdict === "none", wrong: had.verdict === "box_wrong", pixel: had.pixel };
  }
  const { face, label } = state.choice;
  return { ...blank(), face, label };
}

function renderAsks() {
  const here = state.shown && state.shown.ask ? 1 : 0, waiting = state.asks - here;
  show("asks", waiting > 0, `The robot asks: ${waiting} waiting (A)`);
}

function renderProposal(proposal) {
  show("proposal", proposal !== null);
  document.body.classList.toggle("speaks", proposal !== null);
  if (!proposal) return;
  const [head, body] = at("proposal").children;
  head.textContent = proposal.status === "grasp" ? `The robot proposes: ${proposal.headline}` : `The robot asks: ${proposal.headline}`;
  body.textContent = [`Ordered by ${proposal.ranker}.`, ...proposal.warnings.map((item) => `Warning: ${item}.`)].join(" ");
}

function renderFaces(shown) {
  at("faces").replaceChildren(...FACES.map(([name, small], k) => {
    const button = numbered(k + 1, name, small, FACE_COLORS[k]);
    button.onclick = () => chooseFace(k + 1);
    button.id = `face-${k + 1}`;
    return button;
  }));
  at("lines").replaceChildren(...Array.from({ length: shown.lines }, (_, k) => {
    const button = numbered(k + 1, "", "", "");
    button.id = `line-${k + 1}`;
    button.onclick = () => chooseLine(k + 1);
    button.onmouseenter = () => mine.face && tellChoice(mine.face, (mine.face - 1) * shown.lines + k + 1);
    button.onmouseleave = () => mine.face && tellChoice(mine.face, mine.label);
    return button;
  }));
}

function numbered(number, name, small, color) {
  const button = document.createElement("button");
  const [head, words, more] = ["b", "span", "small"].map((kind) => document.createElement(kind));
  head.textContent = number;
  words.textContent = name;
  more.textContent = small;
  button.append(head, words, more);
  if (color) button.style.setProperty("--own", color);
  return button;
}

function renderChoice() {
  const shown = state && state.shown;
  if (!shown) return;
  const line = mine.label === null ? null : (mine.label - 1) % shown.lines + 1;
  FACES.forEach((_, k) => at(`face-${k + 1}`).setAttribute("aria-pressed", String(mine.face === k + 1)));
  for (let k = 1; k <= shown.lines; k += 1) {
    const button = at(`line-${k}`);
    button.disabled = mine.face === null;
    button.setAttribute("aria-pressed", String(line === k));
    const told = shown.told && mine.face ? shown.told[(mine.face - 1) * shown.lines + k - 1] : null;
    const kind = told && told.category ? CATEGORIES[told.category] : null;
    button.children[1].textContent = mine.face ? shown.line_names[mine.face - 1][k - 1] : "";
    button.children[2].textContent = kind ? `${kind[2]} ${kind[0]}, ${(100 * told.clearance_m).toFixed(1)} cm` : "";
    button.style.setProperty("--own", kind ? kind[1] : mine.face ? FACE_COLORS[mine.face - 1] : "#9aa0a8");
  }
  at("none").setAttribute("aria-pressed", String(mine.none));
  at("wrong").setAttribute("aria-pressed", String(mine.wrong));
  at("image").classList.toggle("pick", mine.wrong);
  at("said").textContent = words(shown, line);
  at("save").disabled = !ready() || busy;
  const told = shown.told && mine.label ? shown.told[mine.label - 1] : null;
  show("failed", Boolean(told && told.failed.length));
  at("failed").replaceChildren(...(told ? told.failed : []).map((sentence) => {
    const item = document.createElement("li");
    item.textContent = sentence;
    return item;
  }));
  const spot = at("spot");
  spot.hidden = !(mine.wrong && mine.pixel && shown.width_px);
  if (!spot.hidden) {
    const place = imagePlace(), figure = at("picture").getBoundingClientRect();
    spot.style.left = `${place.left - figure.left + (mine.pixel[0] + 0.5) / shown.width_px * place.width}px`;
    spot.style.top = `${place.top - figure.top + (mine.pixel[1] + 0.5) / shown.height_px * place.height}px`;
  }
}

function words(shown, line) {
  if (mine.none) return "None: I would help.";
  if (mine.wrong) return mine.pixel ? `The box is wrong; the right thing is at ${mine.pixel[0]}, ${mine.pixel[1]}.`
    : "The box is wrong. Click on the right thing, in the picture or in the cloud, or save as it is.";
  if (mine.face === null) return "Which face? 1 to 5";
  if (line === null) return `${capital(FACE_WORDS[mine.face - 1])}. Which line? 1 to ${shown.lines}`;
  const name = shown.line_names[mine.face - 1][line - 1];
  return `${capital(FACE_WORDS[mine.face - 1])}, line ${line}${name ? ` (${name})` : ""}.`;
}

const capital = (text) => text[0].toUpperCase() + text.slice(1);

function spell(seconds) {
  const minutes = Math.round(seconds / 60);
  if (minutes < 1) return "less than a minute";
  return minutes < 90 ? `${minutes} min` : `${(minutes / 60).toFixed(1)} h`;
}

/* ---- learning ---- */

async function openLearning() {
  at("learn-box").showModal();
  await refreshLearning();
}

async function refreshLearning() {
  if (!at("learn-box").open || !state) return;
  try {
    const [told, agreed] = await Promise.all([ask("/api/learning"), ask(`/api/agreements?session=${state.session}`)]);
    renderLearning(told);
    renderAgreements(agreed);
    if (told.state === "running") setTimeout(refreshLearning, 500);
  } catch (error) { at("learn-said").textContent = error.message; }
}

function renderLearning(told) {
  const latest = told.latest, running = told.state === "running";
  const standing = latest ? `Learned from ${latest.labels} labels, ${latest.nones} of them none.` : "Nothing is learned yet.";
  at("learn-said").textContent = told.message || standing;
  at("learn-box").dataset.state = told.state;
  show("learn-bar", running);
  at("learn-bar").value = told.fraction;
  at("learn-now").disabled = running;
  at("learn-stop").hidden = !running;
  const versions = latest ? latest.versions : [];
  drawCurve(at("curve"), versions.filter((item) => item.curve.length).map((item) => ({ name: item.name, points: item.curve })),
    latest ? latest.commonest : null);
  fill("learn-table", latest ? [["", "agrees with you", "each answer alike", ""], ...versions.map((item) => [item.name,
    `${percent(item.agreement)} (\u00b1 ${Math.round(100 * item.spread)})`, percent(item.balanced), item.why]),
    ["always the commonest answer", percent(latest.commonest), "", ""], ...latest.notes.map((note) => [note])] : []);
  at("models").replaceChildren(...told.models.map((model) => {
    const label = document.createElement("label"), button = document.createElement("input");
    Object.assign(button, { type: "radio", name: "model", checked: model.number === told.active, disabled: !model.usable });
    button.onchange = () => ask("/api/model", { session: state.session, number: model.number })
      .then(() => { refresh(); refreshLearning(); })
      .catch((error) => { at("learn-said").textContent = error.message; });
    label.append(button, document.createTextNode(model.name));
    return label;
  }));
}

function renderAgreements(agreed) {
  fill("agreements", agreed.length ? agreed.map((item) => [
    item.first === item.second ? `${item.first} with themselves` : `${item.first} and ${item.second}`,
    `${percent(item.same)} the same`, item.kappa === null ? "" : `kappa ${item.kappa.toFixed(2)}`, `${item.scenes} scenes`,
  ]) : [["No scene has two labels yet."]]);
}

function fill(id, rows) {
  at(id).replaceChildren(...rows.map((cells) => {
    const row = document.createElement("tr");
    row.append(...cells.map((text) => {
      const cell = document.createElement("td");
      cell.textContent = text;
      return cell;
    }));
    return row;
  }));
}

const percent = (share) => `${Math.round(100 * share)} %`;

/* ---- keys and buttons ---- */

const ACTIONS = {
  s: () => (state.shown ? step("/api/skip") : step("/api/skipped")),
  u: () => step("/api/undo"),
  b: () => step("/api/back"),
  n: () => step("/api/forward"),
  a: () => step("/api/ask"),
  w: () => choose({ wrong: !mine.wrong }),
  r: () => ask("/api/camera", { session: state.session }).catch(() => comeBack()),
  c: () => state.shown && step("/api/reveal", { on: state.shown.told === null }),
  j: () => { at("number").max = state.progress.scenes; at("jump-box").showModal(); at("number").focus(); },
  l: openLearning,
  m: () => at("note").focus(),
  "?": () => at("help-box").showModal(),
};

/* Returns whether the key meant something. */
function onKey(event) {
  if (!state || event.ctrlKey || event.altKey || event.metaKey) return false;
  if (document.querySelector("dialog[open]")) return false;
  if (event.target.tagName === "INPUT") {
    if (event.key === "Escape" || event.key === "Enter") { event.target.blur(); event.preventDefault(); return true; }
    return false;
  }
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (key === "Enter" && event.target.tagName === "BUTTON" && event.target.id !== "save" && !ready()) return false;
  if (key === "Enter") save();
  else if (key === "Escape" || key === "Backspace") takeBack();
  else if (key === "ArrowLeft") ACTIONS.b();
  else if (key === "ArrowRight") ACTIONS.n();
  else if (/^[0-9]$/.test(key)) { if (state.shown) digit(Number(key)); }
  else if (ACTIONS[key]) ACTIONS[key]();
  else return false;
  event.preventDefault();
  return true;
}

document.addEventListener("keydown", onKey);
setInterval(hearView, 100); // a frame tells of its new page only when all of that is loaded
at("save").onclick = save;
at("none").onclick = () => choose({ none: !mine.none });
at("asks").onclick = () => ACTIONS.a();
at("image").onclick = spotAt;
at("image").onload = () => { document.body.dataset.image = new URL(at("image").src).searchParams.get("serial"); renderChoice(); };
for (const [id, key] of [["wrong", "w"], ["back", "b"], ["forward", "n"], ["undo", "u"], ["skip", "s"],
  ["camera", "r"], ["colors", "c"], ["jump", "j"], ["learn", "l"], ["help", "?"]]) {
  at(id).onclick = () => ACTIONS[key]();
}
at("jump-box").onclose = () => {
  if (at("jump-box").returnValue === "go") step("/api/jump", { number: Number(at("number").value) });
};
at("learn-now").onclick = () => ask("/api/learn", { session: state.session }).then(refreshLearning)
  .catch((error) => { at("learn-said").textContent = error.message; });
at("learn-stop").onclick = () => ask("/api/learn/stop", { session: state.session }).then(refreshLearning).catch(() => undefined);

async function start() {
  let known;
  try { known = await ask("/api/start"); } catch (error) {
    show("lost", true, error.status ? error.message : "The server cannot be reached; trying again.");
    await wait(RETRY_MS);
    return start();
  }
  show("lost", false);
  const name = known.operator || localStorage.getItem("boxgrasp-operator") || "";
  document.title = `boxgrasp: ${known.mode}`;
  if (name && (known.operator || sessionStorage.getItem("boxgrasp-begun"))) return enter(name);
  at("name").value = name;
  at("start-box").oncancel = (event) => event.preventDefault();
  at("start-box").onclose = () => enter(at("name").value);
  at("start-box").showModal();
  at("name").select();
}

async function enter(name) {
  sessionStorage.setItem("boxgrasp-begun", "yes");
  try { await begin(name); await sendPending(); } catch (error) {
    if (error.status === 0) return comeBack();
    sessionStorage.removeItem("boxgrasp-begun");
    show("lost", true, error.message);
    await wait(2 * RETRY_MS);
    return start();
  }
}

start();
