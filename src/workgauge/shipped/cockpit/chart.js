// Clearance and joint speeds of the last half minute, on one canvas.
const SPAN_S = 30;
const SHADES = {
  light: ["#0072b2", "#d55e00", "#00805c", "#b0588a", "#a86f00", "#3a86b0", "#6f6f6f", "#b8321a"],
  dark: ["#56b4e9", "#ff9a57", "#3fbf97", "#e5a5c9", "#f0c246", "#a5d8f5", "#b5b5b5", "#ff7a52"],
};

export class Chart {
  constructor(canvas) {
    this.canvas = canvas;
    this.points = [];
  }

  take(now, joints) {
    const last = this.points.at(-1);
    if (last && now.t_s < last.t) this.points = [];
    if (last && now.t_s === last.t) return;
    const near = now.near.find((one) => one.kind !== "self");
    const speeds = now.allowed.map((speed, j) => speed / (speed > 0 ? joints[j].speed_positive : joints[j].speed_negative));
    this.points.push({ t: now.t_s, near: near ? near.distance_m : null, speeds });
    while (this.points[0].t < now.t_s - SPAN_S) this.points.shift();
  }

  draw(joints, keep) {
    const ratio = devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (this.canvas.width !== Math.round(width * ratio)) this.canvas.width = Math.round(width * ratio);
    if (this.canvas.height !== Math.round(height * ratio)) this.canvas.height = Math.round(height * ratio);
    const pen = this.canvas.getContext("2d");
    const shades = SHADES[document.documentElement.dataset.theme] ?? SHADES.light;
    const style = getComputedStyle(document.documentElement);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = "11px system-ui, sans-serif";
    const half = Math.floor(width / 2) - 12;
    const end = this.points.at(-1)?.t ?? 0;
    const top = 14;
    const bottom = height - 3;
    const x = (t, from) => from + ((t - end + SPAN_S) / SPAN_S) * half;
    const frame = (from, words) => {
      pen.strokeStyle = style.getPropertyValue("--line");
      pen.strokeRect(from + 0.5, top + 0.5, half, bottom - top);
      pen.fillStyle = style.getPropertyValue("--soft");
      pen.fillText(words, from, 10);
    };
    const line = (from, y, value, colour, wide) => {
      pen.beginPath();
      let begun = false;
      for (const point of this.points) {
        const v = value(point);
        if (v === null || v === undefined) { begun = false; continue; }
        if (begun) pen.lineTo(x(point.t, from), y(v)); else pen.moveTo(x(point.t, from), y(v));
        begun = true;
      }
      pen.strokeStyle = colour;
      pen.lineWidth = wide;
      pen.stroke();
      pen.lineWidth = 1;
    };
    const most = 2;
    const metres = (v) => bottom - (Math.max(0, Math.min(most, v)) / most) * (bottom - top);
    frame(0, `nearest limit, 0 to ${most} m, 30 s`);
    if (keep > 0) {
      pen.setLineDash([4, 3]);
      pen.strokeStyle = style.getPropertyValue("--stop");
      pen.beginPath(); pen.moveTo(0, metres(keep)); pen.lineTo(half, metres(keep)); pen.stroke();
      pen.setLineDash([]);
    }
    line(0, metres, (point) => point.near, style.getPropertyValue("--go"), 2);
    const from = half + 24;
    const speeds = "joint speeds, ±100 %";
    frame(from, speeds);
    const share = (v) => (top + bottom) / 2 - v * (bottom - top - 2) / 2;
    let at = from + pen.measureText(speeds).width + 12;
    joints.forEach((joint, j) => {
      line(from, share, (point) => point.speeds[j], shades[j % shades.length], 1.6);
      pen.fillStyle = shades[j % shades.length];
      if (at + pen.measureText(joint.name).width < from + half) pen.fillText(joint.name, at, 10);
      at += pen.measureText(joint.name).width + 10;
    });
  }
}
