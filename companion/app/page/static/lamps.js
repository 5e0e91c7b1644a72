// What each lamp shows: of a state, and how old that is. No lamp is green by what was true a while ago.

export const STALE_S = 1;
const NO_ECHO_S = 2.5;
const INPUTS = ["camera", "IMU", "magnetometer", "GPS", "ultrasonic"];

// Lamps as {name, words, kind}; kind: good, warning (it works badly), silent (it is lost), absent (nothing to
// show, no fault), unknown (nobody knows now).
export function lamps(state, oldS) {
  if (!state) return ["autopilot", ...INPUTS, "estimate", "pad"].map((name) => ({ name, words: "not known yet", kind: "unknown" }));
  const found = new Map(state.inputs.map((input) => [input.name, input]));
  const rows = [{ name: "autopilot", words: state.autopilot || "no heartbeat", kind: state.autopilot ? "good" : "silent" }];
  for (const name of state.vision_only ? ["camera"] : INPUTS) rows.push({ name, ...inputLamp(name, found.get(name), oldS) });
  if (!state.vision_only) rows.push({ name: "estimate", ...estimateLamp(state) });
  rows.push({ name: "pad", ...padLamp(state, oldS) });
  if (oldS <= STALE_S) return rows;
  return rows.map((row) => ({ ...row, words: `was: ${row.words}`, kind: "unknown" }));
}

function inputLamp(name, input, oldS) {
  if (!input) return { words: "nothing yet", kind: name === "ultrasonic" ? "absent" : "silent" };
  const age = input.age_s + oldS;
  if (input.silent) return { words: age < 1 ? "silent" : `silent for ${duration(age)}`, kind: "silent" };
  if (age > NO_ECHO_S) return { words: `${duration(age)} ago`, kind: "absent" };  // from high up there is no echo
  const rate = input.rate_hz > 0 ? `${input.rate_hz.toFixed(input.rate_hz < 1 ? 1 : 0)} Hz` : "begins";
  if (input.unused && name !== "ultrasonic") return { words: `${rate}, NOT USED: ${input.reason}`, kind: "warning" };
  return { words: rate + (age >= 1 ? `, ${duration(age)} ago` : ""), kind: "good" };
}

function estimateLamp(state) {
  if (!state.aligned) return { words: "not aligned", kind: "silent" };
  const words = `±${state.attitude_std_deg.toFixed(1)}°, ±${state.velocity_std_m_s.toFixed(2)} m/s`;
  return { words: state.estimate_problem ? `${words}: not good enough` : words, kind: state.estimate_problem ? "silent" : "good" };
}

function padLamp({ pad_seen_s: seen }, oldS) {
  if (seen === null) return { words: "not seen", kind: "absent" };
  const age = seen + oldS;
  return age < 1 ? { words: "in sight", kind: "good" } : { words: `seen ${duration(age)} ago`, kind: "warning" };
}

export function duration(seconds) {
  return seconds < 120 ? `${seconds.toFixed(0)} s` : seconds < 7200 ? `${(seconds / 60).toFixed(0)} min` : `${(seconds / 3600).toFixed(0)} h`;
}
