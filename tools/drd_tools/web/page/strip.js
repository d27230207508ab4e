// The last hour as a strip: how the 99 % bound grew, the validity below it, and the time that is looked at.

const BAND = 8; // height of the validity's band, pixels
const EDGE = 6; // half the slider's thumb: so far its middle stays from the ends
const BREAK_S = 1.5;
const COLOURS = ["--initialising", "--valid", "--degraded", "--invalid"];

/** Draws `rows` from `begin` to `end` (s); returns the largest bound in metres, 0 where there is none. */
export function drawStrip(canvas, rows, begin, end, at) {
  const c = canvas.getContext("2d");
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name).trim();
  const floor = height - BAND - 3;
  const px = (t) => EDGE + ((t - begin) / Math.max(end - begin, 1e-9)) * (width - 2 * EDGE);
  c.fillStyle = colour("--gap");
  c.globalAlpha = 0.35;
  c.fillRect(EDGE, height - BAND, width - 2 * EDGE, BAND);
  c.globalAlpha = 1;
  const most = rows.reduce((highest, row) => Math.max(highest, row.bound), 0);
  bounds(c, rows, px, (bound) => floor - (bound / (most || 1)) * (floor - 3), floor, colour("--accent"));
  for (let i = 0; i < rows.length; ) {
    let j = i;
    while (j + 1 < rows.length && rows[j + 1].validity === rows[i].validity && rows[j + 1].t - rows[j].t < BREAK_S) j++;
    c.fillStyle = colour(COLOURS[rows[i].validity] ?? "--gap");
    const next = j + 1 < rows.length && rows[j + 1].t - rows[j].t < BREAK_S ? rows[j + 1].t : rows[j].t;
    c.fillRect(px(rows[i].t), height - BAND, Math.max(1.5, px(next) - px(rows[i].t)), BAND);
    i = j + 1;
  }
  if (at !== null) {
    const x = px(Math.min(end, Math.max(begin, at)));
    c.fillStyle = colour("--ink");
    c.fillRect(x - 1, 0, 2, height);
    c.beginPath();
    c.arc(x, 5, 5, 0, 2 * Math.PI);
    c.fill();
  }
  return most;
}

function bounds(c, rows, px, py, floor, colour) {
  c.fillStyle = c.strokeStyle = colour;
  let begin = null;
  let drawn = -Infinity;
  const close = (t) => {
    if (begin === null) return;
    c.lineTo(px(t), floor);
    c.lineTo(px(begin), floor);
    c.globalAlpha = 0.28;
    c.fill();
    c.globalAlpha = 1;
    begin = null;
  };
  let last = null;
  for (const row of rows) {
    if (last && row.t - last.t >= BREAK_S) close(last.t);
    const x = px(row.t);
    if (begin === null) {
      c.beginPath();
      c.moveTo(x, py(row.bound));
      [begin, drawn] = [row.t, x];
    } else if (x - drawn > 0.8) {
      c.lineTo(x, py(row.bound));
      drawn = x;
    }
    last = row;
  }
  if (last) close(last.t);
}
