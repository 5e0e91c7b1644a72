// The camera's picture, and over it the pad, the used markers and the predicted touchdown.

const PAD = "#ff8c00", MARKER = "#16e06a", TOUCHDOWN = "#ff2020";
const SMALLEST_LABELLED = 34; // px on the screen: a smaller marker has no room for its number

export class Picture {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
  }

  // Draws; `image` is an ImageBitmap.
  draw(image, look) {
    const canvas = this.canvas, c = this.context, dpr = window.devicePixelRatio || 1;
    const width = Math.round(canvas.clientWidth * dpr), height = Math.round(canvas.clientHeight * dpr);
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const scale = Math.min(width / image.width, height / image.height);
    const left = (width - scale * image.width) / 2, top = (height - scale * image.height) / 2;
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.fillStyle = "#222";
    c.fillRect(0, 0, width, height);
    c.drawImage(image, left, top, scale * image.width, scale * image.height);
    c.save();
    c.beginPath();
    c.rect(left, top, scale * image.width, scale * image.height);
    c.clip();
    const place = ([u, v]) => [left + scale * u, top + scale * v];
    c.lineJoin = "round";
    for (const { id, corners } of look.outlines) this.outline(corners.map(place), id, dpr);
    if (look.touchdown) this.touchdown(place(look.touchdown), [left, top, left + scale * image.width, top + scale * image.height], dpr);
    c.restore();
  }

  outline(points, id, dpr) {
    const c = this.context;
    c.beginPath();
    points.forEach(([x, y]) => c.lineTo(x, y));
    c.closePath();
    this.cased(id === null ? PAD : MARKER, (id === null ? 3.5 : 2.5) * dpr);
    const size = Math.hypot(points[0][0] - points[1][0], points[0][1] - points[1][1]);
    if (id === null || size < SMALLEST_LABELLED * dpr) return;
    const x = points.reduce((sum, p) => sum + p[0], 0) / 4, y = points.reduce((sum, p) => sum + p[1], 0) / 4;
    c.font = `800 ${15 * dpr}px system-ui, "DejaVu Sans", sans-serif`;
    c.textAlign = "center";
    c.textBaseline = "middle";
    c.strokeStyle = "#000";
    c.lineWidth = 4 * dpr;
    c.strokeText(id, x, y);
    c.fillStyle = "#fff";
    c.fillText(id, x, y);
  }

  // A ring with a cross; beyond the picture's edge an arrow there.
  touchdown([x, y], [left, top, right, bottom], dpr) {
    const c = this.context, inset = 18 * dpr;
    const nearX = Math.min(Math.max(x, left + inset), right - inset), nearY = Math.min(Math.max(y, top + inset), bottom - inset);
    c.beginPath();
    if (nearX === x && nearY === y) {
      const r = 13 * dpr;
      c.arc(x, y, r, 0, 2 * Math.PI);
      c.moveTo(x - 1.6 * r, y); c.lineTo(x + 1.6 * r, y);
      c.moveTo(x, y - 1.6 * r); c.lineTo(x, y + 1.6 * r);
      this.cased(TOUCHDOWN, 3.5 * dpr);
      return;
    }
    const angle = Math.atan2(y - nearY, x - nearX), r = 15 * dpr;
    c.moveTo(nearX + r * Math.cos(angle), nearY + r * Math.sin(angle));
    for (const turn of [2.5, -2.5]) c.lineTo(nearX + r * Math.cos(angle + turn), nearY + r * Math.sin(angle + turn));
    c.closePath();
    this.cased(TOUCHDOWN, 3.5 * dpr);
    c.fillStyle = TOUCHDOWN;
    c.fill();
  }

  // A coloured line with a black edge shows on light and on dark.
  cased(colour, width) {
    const c = this.context;
    c.strokeStyle = "#000";
    c.lineWidth = 1.9 * width;
    c.stroke();
    c.strokeStyle = colour;
    c.lineWidth = width;
    c.stroke();
  }
}
