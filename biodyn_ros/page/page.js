// The live page: shows the snapshots of the node. Texts are set as text, never as markup.
"use strict";

const STALE_MS = 1500; // six snapshots late
const MINUTE_S = 60;
const BIN_S = 0.1;
const MARGIN = { left: 52, right: 4, top: 6, bottom: 22 };
const SIGN = { good: "✓", warn: "!", bad: "✕", none: "?" };
const DOT = [["●", "streaming"], ["▲", "warning"], ["✖", "error"]];
const $ = (id) => document.getElementById(id);

let snapshot = null;
let receivedAt = 0;
let clockDifference = 0; // this clock minus the server's, plus the shortest delay of an event; ms
let minute = {};

// --- words -------------------------------------------------------------------------------------------------------

function number(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size === 0 || size < 0.001 || size >= 1e6) return value.toPrecision(3);
  return value.toFixed(Math.max(0, 2 - Math.floor(Math.log10(size))));
}

function short(value) {
  return value === null ? "–" : value.toFixed(value < 10 ? 2 : 1);
}

function whole(value) {
  return value === null ? "–" : value.toFixed(0);
}

function interval(ends, format) {
  return ends === null ? "" : ends.map(format).join("–");
}

function clock(seconds) {
  return seconds > 1e9 ? new Date(1000 * seconds).toLocaleTimeString() : `${seconds.toFixed(1)} s`;
}

function element(tag, kind, text) {
  const made = document.createElement(tag);
  if (kind) made.className = kind;
  if (text !== undefined) made.textContent = text;
  return made;
}

// --- band --------------------------------------------------------------------------------------------------------

function band(of) {
  const tone = of.verdict.tone in SIGN ? of.verdict.tone : "none";
  document.body.dataset.tone = tone;
  $("sign").textContent = SIGN[tone];
  $("headline").textContent = of.verdict.headline;
  $("reason").textContent = of.verdict.reasons[0] ?? "";
  $("left-action").textContent = of.seat ? of.seat.left.action : "–";
  $("left-limit").textContent = of.seat ? of.seat.left.limit : "–";
  $("figures").replaceChildren(...(of.seat ? of.seat.figures.map((each) => figure(each, of.seat.lower_bound)) : []));
}

function figure(of, lower) {
  const made = element("div", "figure");
  const value = element("p", "value", `${of.name} ${lower ? "≥ " : ""}${number(of.so_far)} `);
  value.append(element("small", "", `${of.unit} so far, ${of.axis} `));
  if (of.governs) value.append(element("i", "", "governs"));
  made.append(value);
  if (of.limit !== null) made.append(gauge(of));
  return made;
}

function gauge(of) {
  const end = 1.15 * of.limit;
  const made = element("div", "gauge");
  const fill = element("span");
  fill.style.width = `${100 * Math.min(1, of.so_far / end)}%`;
  made.append(fill);
  for (const [name, value] of [["action", of.action], ["limit", of.limit]]) {
    const tick = element("em");
    tick.style.left = `${(100 * value) / end}%`;
    tick.append(element("span", "", `${name} ${value}`));
    made.append(tick);
  }
  return made;
}

// --- meter -------------------------------------------------------------------------------------------------------

function meter(of) {
  const read = of.meter;
  $("meter-note").textContent = read ? `The seat since reset, weighted (ISO 2631-1), without k. ${read.note}` : "The seat since reset: nothing counted yet.";
  const axes = read ? read.axes : [];
  $("readings").replaceChildren(
    reading("counted", "s", read ? [["", number(read.counted_s)]] : []),
    reading("aw", "m/s²", axes.map((each) => [each.axis, least(each.aw_lower_bound, number(each.aw_mps2))])),
    reading("VDV", "m/s¹·⁷⁵", axes.map((each) => [each.axis, least(each.vdv_lower_bound, number(each.vdv_mps175))])),
    reading("MTVV z", "m/s²", read ? [["", least(read.lower_bound, number(read.mtvv_mps2))]] : []),
    reading("peak z", "m/s²", read ? [["", least(read.lower_bound, number(read.peak_mps2))]] : []),
  );
}

function reading(name, unit, values) {
  const made = element("div", "reading");
  made.dataset.name = name;
  const title = element("dt", "", `${name}, `);
  title.append(element("small", "", unit));
  made.append(title);
  for (const [axis, text] of values.length ? values : [["", "–"]]) {
    const value = element("dd", "");
    if (axis) value.append(element("small", "", axis));
    value.append(element("b", "", text));
    made.append(value);
  }
  return made;
}

// Explains "≥" in every section that contains it.
function bounds(of) {
  const why = of.meter && of.meter.bounds ? of.meter.bounds : "";
  explain($("band"), why || "≥ means at least.");
  explain($("meter"), why || "≥ means at least.");
  const part = of.no_interval === null ? " The interval of a lower bound is that of the counted part." : "";
  explain($("body"), `≥ means at least: samples clipped or stuck (of F also missing, or left out after a loss) since reset.${part}`);
  explain($("ride"), "≥ means at least: samples missing, clipped or stuck since reset.");
}

function explain(section, text) {
  const note = section.querySelector(".bound");
  note.textContent = "";
  if (section.textContent.includes("≥")) note.textContent = text;
}

// --- body --------------------------------------------------------------------------------------------------------

function rows(of) {
  const most = Math.max(0.05, ...of.rows.flatMap((row) => [row.measured_mps2 ?? 0, row.predicted_mps2 ?? 0]));
  $("rows").replaceChildren(...of.rows.map((row) => segment(row, most)));
  // Without the seat no value is updated: the rows show its last window.
  const seat = of.rows.find((row) => row.name === "seat");
  document.querySelector("main").classList.toggle("frozen", seat.sensor.level === 2);
  for (const part of document.querySelectorAll(".part")) {
    const row = of.rows.find((each) => each.name === part.dataset.row);
    part.dataset.level = row && row.sensor ? row.sensor.level : "none";
  }
}

function segment(of, most) {
  const made = element("div", "row");
  made.dataset.name = of.name;
  const [dot, meaning] = of.sensor ? DOT[of.sensor.level] : ["○", "no sensor"];
  const sign = element("span", "dot", dot);
  sign.dataset.level = of.sensor ? of.sensor.level : "none";
  sign.title = meaning;
  const name = element("span", "name", of.name);
  name.append(element("small", "", of.sensor ? of.sensor.message : "predicted only"));
  name.title = of.sensor ? of.sensor.message : "";
  const bars = element("span", "bars");
  for (const [kind, value] of [["bar", of.measured_mps2], ["bar model", of.predicted_mps2]]) {
    const bar = element("div", kind);
    bar.style.width = `${(100 * (value ?? 0)) / most}%`;
    bars.append(bar);
  }
  const values = element("span", "values");
  values.append(element("span", "", least(of.measured_lower_bound, short(of.measured_mps2))));
  values.append(element("span", "model", of.name === "seat" ? "" : least(of.predicted_lower_bound, short(of.predicted_mps2))));
  values.append(element("small", "", interval(of.predicted_interval_mps2, short)));
  const ratio = element("span", "ratio");
  // A line may only break between both peaks.
  const peaks = [of.compression_n, of.tension_n].map((peak) => least(of.force_lower_bound, whole(peak)).replace(" ", "\u00a0"));
  if (of.name !== "seat") ratio.append(
    element("span", "", `T ${short(of.measured_ratio)} / ${short(of.predicted_ratio)}`),
    element("span", "model", `F\u00a0${peaks.join(" / ")}`),
    element("small", "", interval(of.compression_interval_n, whole)),
  );
  made.append(sign, name, bars, values, ratio);
  return made;
}

// --- ride --------------------------------------------------------------------------------------------------------

function facts(of) {
  const dri = of.dri;
  $("dri").textContent = dri ? `${dri.lower_bound ? "≥ " : ""}${number(dri.compression)}` : "–";
  fit(of.fit);
  const sensors = of.rows.filter((row) => row.sensor);
  $("rates").textContent = span(sensors.map((row) => row.sensor.rate_hz), "Hz");
  const late = sensors.reduce((a, b) => ((b.sensor.lag_ms ?? 0) > (a.sensor.lag_ms ?? 0) ? b : a));
  $("lags").textContent = `${number(late.sensor.lag_ms)} ms at most, ${late.name}`;
  $("threshold").textContent = number(of.shock_mps2);
  $("shocks").replaceChildren(...(of.shocks.length ? of.shocks.map(shock) : [noShock()]));
  $("marks").textContent = of.marks.map((mark) => `${mark.name} at ${clock(mark.at_s)}`).join(", ") || "none";
  const row = chosen();
  const percent = row && row.residual_percent !== null ? `, ${number(row.residual_percent)} %` : "";
  $("residual").textContent = row ? `residual ${number(row.residual_mps2)} m/s² rms${percent}` : "";
}

function fit(of) {
  $("fits").textContent = of.fits === null ? "?" : of.fits ? "✓ fits" : "✕ does not fit";
  const found = of.misfits.map((one) => `${one.name} ${number(one.ratio)}`).join(", ");
  const since = clock(Math.min(...of.misfits.map((one) => one.since_s)));
  const text = found ? `${found} times what is usual, since ${since}` : `as in events that it was not fitted to${of.tested}`;
  $("misfits").textContent = of.fits === null ? of.unknown : text;
}

function span(values, unit) {
  const known = values.filter((value) => value !== null);
  if (!known.length) return "unknown";
  const [least, most] = [Math.min(...known).toFixed(1), Math.max(...known).toFixed(1)];
  return `${least === most ? least : `${least} to ${most}`} ${unit}, ${known.length} of ${values.length} sensors`;
}

function shock(of) {
  const made = element("tr");
  made.append(element("td", "", clock(of.at_s)));
  for (const [lower, value] of [
    [of.seat_lower_bound, of.seat_mps2],
    [of.head_lower_bound, of.head_measured_mps2],
    [of.seat_lower_bound, of.head_predicted_mps2],
  ]) {
    made.append(element("td", "", least(lower, number(value))));
  }
  return made;
}

function least(lower, text) {
  return lower && text !== "–" ? `≥ ${text}` : text;
}

function noShock() {
  const made = element("tr");
  made.append(element("td", "", "none"));
  return made;
}

function chosen() {
  return snapshot ? snapshot.rows.find((row) => row.name === $("channel").value) : undefined;
}

function channels(of) {
  if ($("channel").options.length) return;
  for (const row of of.rows) $("channel").append(element("option", "", row.name));
}

// --- strip -------------------------------------------------------------------------------------------------------

function remember(strip) {
  for (const [name, bins] of Object.entries(strip)) {
    const kept = minute[name] ?? (minute[name] = []);
    bins.begin_s.forEach((begin, at) => {
      const last = kept.length ? kept[kept.length - 1].begin : begin - BIN_S;
      if (!(begin > last && begin - last <= MINUTE_S)) kept.length = 0; // another clock, or a restarted bag
      kept.push({ begin, low: bins.low[at], high: bins.high[at] });
    });
    const end = kept.length ? kept[kept.length - 1].begin : 0;
    while (kept.length && kept[0].begin < end - MINUTE_S) kept.shift();
  }
}

function draw() {
  const canvas = $("strip");
  const scale = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  const row = chosen();
  if (!row) return;
  const measured = line(minute.measured ?? [], row.measured_column);
  const predicted = line(minute.predicted ?? [], row.predicted_column);
  const all = [...measured, ...predicted];
  if (!all.length) return;
  const end = Math.max(...all.map((bin) => bin.begin)) + BIN_S;
  // The measurement sets the scale: a diverging prediction may exceed it.
  const scaled = measured.length ? measured : predicted;
  const most = 1.1 * Math.max(0.2, ...scaled.flatMap((bin) => [Math.abs(bin.low), Math.abs(bin.high)]));
  const plot = { left: MARGIN.left, top: MARGIN.top, width: width - MARGIN.left - MARGIN.right, height: height - MARGIN.top - MARGIN.bottom };
  const place = {
    ...plot,
    x: (s) => plot.left + plot.width * (1 - (end - s) / MINUTE_S),
    y: (a) => plot.top + plot.height * (0.5 - a / (2 * most)),
  };
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);
  const lines = axes(place, most);
  label(pen, lines, colour);
  pen.save();
  pen.beginPath();
  pen.rect(plot.left, plot.top, plot.width, plot.height);
  pen.clip();
  pen.strokeStyle = colour("--line");
  pen.lineWidth = 1;
  for (const { from, to } of lines) stroke(pen, ...from, ...to);
  pen.fillStyle = colour("--area");
  for (const bin of measured) bar(pen, place, bin);
  pen.fillStyle = colour("--interval");
  for (const run of runs(widened(predicted, row.predicted_column))) outline(pen, place, run);
  // The gaps of the dashes show the measurement under an overlapping line.
  curves(pen, place, measured, { colour: colour("--measured"), width: 2.4, dashes: [] });
  curves(pen, place, predicted, { colour: colour("--predicted"), width: 1.8, dashes: [6, 6] });
  pen.restore();
}

function curves(pen, place, bins, style) {
  pen.strokeStyle = style.colour;
  pen.lineWidth = style.width;
  pen.setLineDash(style.dashes);
  for (const side of ["low", "high"]) trace(pen, place, bins, side);
  pen.setLineDash([]);
}

function line(bins, column) {
  if (column === null) return [];
  return bins.filter((bin) => bin.low[column] !== null).map((bin) => ({ begin: bin.begin, low: bin.low[column], high: bin.high[column] }));
}

// The bins with a known interval of the true acceleration, from its lowest to its highest value.
function widened(bins, column) {
  const errors = new Map(line(minute.error ?? [], column).map((error) => [error.begin, error]));
  return bins.flatMap(({ begin, low, high }) => {
    const error = errors.get(Math.floor(begin + BIN_S / 2));
    return error ? [{ begin, low: low + error.low, high: high + error.high }] : [];
  });
}

function runs(bins) {
  const found = [];
  let before = -Infinity;
  for (const bin of bins) {
    if (bin.begin - before > 1.5 * BIN_S) found.push([]);
    found[found.length - 1].push(bin);
    before = bin.begin;
  }
  return found;
}

// Lines of the grid, each with its label in the margin: levels on the left, times below.
function axes(place, most) {
  const step = 10 ** Math.floor(Math.log10(most));
  const level = most / step >= 5 ? 5 * step : most / step >= 2 ? 2 * step : step;
  const bottom = place.top + place.height;
  const levels = [-level, 0, level].map((value) => {
    const y = place.y(value);
    return { from: [place.left, y], to: [place.left + place.width, y], words: number(value), at: [place.left - 5, y + 4], align: "right" };
  });
  const times = [60, 50, 40, 30, 20, 10, 0].filter((past) => place.width >= 400 || past % 20 === 0).map((past) => {
    const x = place.left + place.width * (1 - past / MINUTE_S);
    const align = past === 0 ? "right" : "center";
    return { from: [x, place.top], to: [x, bottom], words: past ? `−${past} s` : "now", at: [x, bottom + 16], align };
  });
  return [...levels, ...times];
}

function label(pen, lines, colour) {
  pen.font = "13px sans-serif";
  pen.fillStyle = colour("--ink");
  for (const { words, at, align } of lines) {
    pen.textAlign = align;
    pen.fillText(words, ...at);
  }
}

function stroke(pen, x0, y0, x1, y1) {
  pen.beginPath();
  pen.moveTo(x0, y0);
  pen.lineTo(x1, y1);
  pen.stroke();
}

function bar(pen, place, bin) {
  const [left, right, top] = [place.x(bin.begin), place.x(bin.begin + BIN_S), place.y(bin.high)];
  pen.fillRect(left, top, right - left + 0.5, Math.max(1, place.y(bin.low) - top));
}

function trace(pen, place, bins, side) {
  for (const run of runs(bins)) {
    pen.beginPath();
    for (const bin of run) pen.lineTo(...point(place, bin, side));
    pen.stroke();
  }
}

function outline(pen, place, run) {
  pen.beginPath();
  for (const bin of run) pen.lineTo(...point(place, bin, "high"));
  for (const bin of [...run].reverse()) pen.lineTo(...point(place, bin, "low"));
  pen.fill();
}

function point(place, bin, side) {
  return [place.x(bin.begin + BIN_S / 2), place.y(bin[side])];
}

// --- updates -----------------------------------------------------------------------------------------------------

function show(of) {
  band(of);
  meter(of);
  channels(of);
  rows(of);
  facts(of);
  bounds(of);
  draw();
  document.body.classList.toggle("intervals", of.no_interval === null);
  for (const window of document.querySelectorAll(".window")) window.textContent = `${of.window_s} s`;
  $("terms").textContent = terms(of);
}

function terms(of) {
  const limits = of.limits;
  const pair = (measure, unit) => (limits[`action_${measure}`] === null ? "none"
    : `${limits[`action_${measure}`]} / ${limits[`limit_${measure}`]} ${unit}`);
  const kept = of.exposure ? ` Exposure: ${of.exposure.message}.` : "";
  const range = of.prediction.extrapolated ? ", and the seat motion exceeds that of the recordings fitted" : "";
  const model = ` They are not validated for this vehicle and seat${range}.`;
  const why = of.verdict.reasons.slice(1).join(" ");
  return `${why} Subject ${of.subject} (${of.mass_matrix}): parameters ${of.origin}. Rolling window ${of.window_s} s. Limits of ${limits.source}, action / limit: `
    + `A(8) ${pair("a8_mps2", "m/s²")}, VDV ${pair("vdv_mps175", "m/s¹·⁷⁵")}; assessed from the seat only, since reset`
    + `${of.seat ? `, ${number(of.seat.counted_s)} s counted, ${number(of.seat.missing_s)} s missing` : ""}. `
    + `Predictions come from a model and are not measurements.${model} ${intervals(of)} Model: ${of.prediction.message}.${kept} biodyn ${of.version}.`;
}

function intervals(of) {
  if (of.no_interval !== null) return `Predictions for ${of.subject} have no 95 % interval: ${of.no_interval}.`;
  if (of.of_group) {
    return "Small figures and the light band: the 95 % interval of people of this mass in published groups. What the model misses of them"
      + " is not in it. The band of a second is drawn when the second is over.";
  }
  return "Small figures and the light band: 95 % interval of the true figure or acceleration, from the residual in events"
    + " that the subject was not fitted to, and from the uncertainty of its parameters. The band of a second is drawn when the second is over."
    + (of.fit.fits === false ? " It does not hold now, because the model does not fit." : "");
}

// Withhold the assessment while the data are late, absent, or of several nodes.
function checkSource() {
  const age = snapshot ? performance.now() - clockDifference - snapshot.received_ms : Infinity;
  const fresh = age <= STALE_MS;
  const sound = fresh && !snapshot.is_mixed;
  document.body.classList.toggle("stale", !sound);
  if (sound) return;
  document.body.dataset.tone = "none";
  $("sign").textContent = SIGN.none;
  if (!snapshot) return;
  const seconds = Math.floor(age / 1000);
  if (fresh) {
    say("Undecided: several nodes", "Several nodes of one name send data to this page. Give each a name of its own: --ros-args -r __node:=NAME");
  } else if (performance.now() - receivedAt <= STALE_MS) {
    say(`Data are ${seconds} s old`, "The connection to the page is too slow. The page shows the values of that time.");
  } else {
    say(`No data for ${seconds} s`, "No data from the node. The page shows the last known values.");
  }
}

function say(headline, reason) {
  $("headline").textContent = headline;
  $("reason").textContent = reason;
}

function listen() {
  const events = new EventSource("events");
  events.addEventListener("clock", (event) => {
    clockDifference = performance.now() - JSON.parse(event.data);
  });
  events.addEventListener("history", (event) => {
    minute = {};
    remember(JSON.parse(event.data));
    draw();
  });
  events.addEventListener("snapshot", (event) => {
    snapshot = JSON.parse(event.data);
    receivedAt = performance.now();
    clockDifference = Math.min(clockDifference, receivedAt - snapshot.received_ms);
    remember(snapshot.strip);
    show(snapshot);
    checkSource();
  });
  events.onerror = () => {
    if (events.readyState !== EventSource.CLOSED) return; // the browser reconnects by itself
    setTimeout(listen, 2000);
  };
}

// --- buttons -----------------------------------------------------------------------------------------------------

function token() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  return given ?? "";
}

async function call(name) {
  $("reply").textContent = "…";
  try {
    const response = await fetch(name, { method: "POST", headers: { "X-Biodyn-Token": token() } });
    const text = await response.text();
    $("reply").textContent = response.ok ? JSON.parse(text).message : text.trim();
  } catch {
    $("reply").textContent = `${name}: the server of the page does not respond`;
  }
}

function buttons() {
  const allowed = token() !== "";
  for (const name of ["mark", "reset"]) $(name).disabled = !allowed;
  if (!allowed) $("reply").textContent = "To mark or reset, open the link with the token that the node prints.";
  $("mark").addEventListener("click", () => call("mark"));
  let armed = 0;
  $("reset").addEventListener("click", () => {
    const button = $("reset"); // needs a second click, because a reset cannot be undone
    if (button.classList.contains("armed")) {
      disarm();
      call("reset");
      return;
    }
    button.classList.add("armed");
    button.textContent = "Press again to reset";
    armed = setTimeout(disarm, 4000);
  });
  function disarm() {
    clearTimeout(armed);
    $("reset").classList.remove("armed");
    $("reset").textContent = "Reset";
  }
}

function theme() {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  let own = localStorage.getItem("biodyn-theme");
  const put = () => {
    document.documentElement.dataset.theme = own ?? (dark.matches ? "dark" : "light");
    draw();
  };
  dark.addEventListener("change", put);
  $("theme").addEventListener("click", () => {
    own = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    localStorage.setItem("biodyn-theme", own);
    put();
  });
  put();
}

theme();
buttons();
$("channel").addEventListener("change", () => { facts(snapshot); draw(); });
addEventListener("resize", draw);
addEventListener("hashchange", () => location.reload());
setInterval(checkSource, 250);
listen();
