// A screen that stays on, and a sound and a shake when something changes: a pilot looks at the vehicle.
// A browser allows sound after a touch only, and the wake lock only on this machine or over a secured connection.

let audio = null, lock = null, wanted = false;

export async function toggle() {
  wanted = !wanted;
  if (!wanted) { await lock?.release(); lock = null; return ""; }
  audio ??= new AudioContext();
  await audio.resume();
  await keepOn();
  beep(660, 0.12);
  return lock ? "sound, screen stays on" : "sound; this browser lets the screen go dark";
}

// the lock is lost whenever the page is hidden
export async function keepOn() {
  if (!wanted || !navigator.wakeLock || document.hidden) return;
  try { lock = await navigator.wakeLock.request("screen"); } catch { lock = null; }
}

export function sayBad() { beep(440, 0.18, 3); shake([200, 100, 200, 100, 200]); }
export function sayNews() { beep(880, 0.1, 1); shake(80); }

function shake(pattern) { if (navigator.userActivation?.hasBeenActive) navigator.vibrate?.(pattern); }

function beep(frequencyHz, seconds, times = 1) {
  if (!wanted || !audio) return;
  for (let k = 0; k < times; k += 1) {
    const tone = audio.createOscillator(), gain = audio.createGain(), from = audio.currentTime + 2 * k * seconds;
    tone.frequency.value = frequencyHz;
    gain.gain.value = 0.25;
    tone.connect(gain).connect(audio.destination);
    tone.start(from);
    tone.stop(from + seconds);
  }
}
