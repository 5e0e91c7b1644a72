// Height and distance from the pad over the last minute, and below them the phases, on one time axis.

const WINDOW_S = 60, KEPT_S = 120;
const LEFT = 46, RIGHT = 10, GAP = 26, BAND = 72, AXIS = 26;
const COLOURS = {
  standby: "#d9d9d9", connect: "#d9d9d9", arm: "#ffe08a", take_off: "#ffe08a", waypoint: "#c5dcff", route: "#c5dcff",
  search: "#e3c7ff", approach: "#9fd8ff", descend: "#a9eeb0", touchdown: "#57cf7a", landed: "#57cf7a", hold: "#ffb27a", abort: "#ff9c9c",
};

export const words = (phase) => phase.replaceAll("_", " ");

export class Plots {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.rows = []; // time, height over the pad, distance from it, height over the start
    this.phases = []; // time, name
  }

  replace(rows) { this.rows = rows; }

  add(row) {
    const rows = this.rows;
    if (rows.length && row[0] <= rows[rows.length - 1][0]) {
      if (row[0] < rows[rows.length - 1][0] - 1) rows.length = 0; // the app has started anew
      else return;
    }
    rows.push(row);
    while (rows.length && rows[0][0] < row[0] - KEPT_S) rows.shift();
  }

  draw() {
    const canvas = this.canvas, c = this.context, dpr = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * dpr) || canvas.height !== Math.round(height * dpr)) {
      canvas.width = Math.round(width * dpr);
      canvas.height = Math.round(height * dpr);
    }
    c.setTransform(dpr, 0, 0, dpr, 0, 0);
    c.clearRect(0, 0, width, height);
    if (!this.rows.length) return;
    const now = this.rows[this.rows.length - 1][0], from = now - WINDOW_S;
    const across = (t) => LEFT + ((t - from) / WINDOW_S) * (width - LEFT - RIGHT);
    const shown = this.rows.filter((row) => row[0] >= from);
    const plotHeight = (height - 2 * GAP - BAND - AXIS) / 2;
    this.plot("height over the pad, m", GAP - 4, plotHeight, width, across, shown, [[3, "#888", [5, 4], 2], [1, "#000", [], 3]], 1);
    const second = GAP - 4 + plotHeight + GAP;
    this.plot("distance from the pad, m", second, plotHeight, width, across, shown, [[2, "#b80000", [], 3]], 0.2);
    this.timeline(second + plotHeight, width, from, now, across);
  }

  plot(title, top, height, width, across, rows, curves, least) {
    const c = this.context, bottom = top + height;
    let most = least;
    for (const [column] of curves) for (const row of rows) if (row[column] !== null) most = Math.max(most, row[column]);
    const step = niceStep(most / 2.5);
    most = step * Math.ceil(most / step - 1e-9);
    const up = (value) => bottom - (Math.max(value, 0) / most) * height;
    c.font = '600 13px system-ui, "DejaVu Sans", sans-serif';
    c.textBaseline = "middle";
    c.textAlign = "right";
    c.lineWidth = 1;
    for (let value = 0; value <= most + 1e-9; value += step) {
      c.strokeStyle = value === 0 ? "#000" : "#ccc";
      c.beginPath();
      c.moveTo(LEFT, up(value));
      c.lineTo(width - RIGHT, up(value));
      c.stroke();
      c.fillStyle = "#000";
      c.fillText(value.toFixed(step < 0.1 ? 2 : step < 1 ? 1 : 0), LEFT - 6, up(value));
    }
    c.textAlign = "left";
    c.textBaseline = "alphabetic";
    c.font = '700 14px system-ui, "DejaVu Sans", sans-serif';
    c.fillText(title, LEFT, top - 8);
    for (const [column, colour, dashes, thick] of curves) {
      c.strokeStyle = colour;
      c.lineWidth = thick;
      c.setLineDash(dashes);
      c.beginPath();
      let open = false;
      for (const row of rows) {
        if (row[column] === null) { open = false; continue; }
        if (open) c.lineTo(across(row[0]), up(row[column]));
        else c.moveTo(across(row[0]), up(row[column]));
        open = true;
      }
      c.stroke();
    }
    c.setLineDash([]);
  }

  // Along the band where it is long enough, else across it; not at all where it is too short for that too.
  name(text, left, right, band) {
    const c = this.context, middle = (left + right) / 2;
    c.font = '700 13px system-ui, "DejaVu Sans", sans-serif';
    if (c.measureText(text).width < right - left - 6) c.fillText(text, middle, band + BAND / 2 + 1);
    else if (right - left > 15) {
      c.save();
      c.translate(middle + 1, band + BAND / 2);
      c.rotate(-Math.PI / 2);
      c.font = '700 12px system-ui, "DejaVu Sans", sans-serif';
      c.fillText(text, 0, 0, BAND - 4);
      c.restore();
    }
  }

  timeline(top, width, from, now, across) {
    const c = this.context, band = top + 8;
    c.textBaseline = "middle";
    c.textAlign = "center";
    this.phases.forEach(([begin, phase], i) => {
      const end = i + 1 < this.phases.length ? this.phases[i + 1][0] : now;
      if (end <= from || begin >= now) return;
      const left = across(Math.max(begin, from)), right = across(Math.min(end, now));
      c.fillStyle = COLOURS[phase] || "#eee";
      c.fillRect(left, band, right - left, BAND);
      c.strokeStyle = "#000";
      c.lineWidth = 1;
      c.strokeRect(left, band, right - left, BAND);
      c.fillStyle = "#000";
      this.name(words(phase), left, right, band);
    });
    c.font = '600 13px system-ui, "DejaVu Sans", sans-serif';
    c.fillStyle = "#000";
    for (let ago = 0; ago <= WINDOW_S; ago += 15) {
      c.textAlign = ago === 0 ? "right" : ago === WINDOW_S ? "left" : "center";
      c.fillText(ago === 0 ? "now" : `−${ago} s`, across(now - ago), band + BAND + 12);
    }
  }
}

// 1, 2 or 5 times a power of ten.
function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((n) => n * power).find((n) => n >= least - 1e-12);
}
