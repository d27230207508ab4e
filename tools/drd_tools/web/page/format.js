// Numbers and names for people: SI in, degrees and familiar units out.

export const DEG = 180 / Math.PI;
const DASH = "–";

export const isNumber = (value) => typeof value === "number" && Number.isFinite(value);

/** A number with so many decimals and a unit; a dash where there is none. */
export function num(value, digits = 2, unit = "") {
  if (!isNumber(value)) return DASH;
  const text = (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits).replace("-", "−");
  return unit ? `${text} ${unit}` : text;
}

/** A small length or angle with two significant digits at least. */
export function fine(value, unit) {
  if (!isNumber(value)) return DASH;
  return num(value, digitsFor(value, 2, 5), unit);
}

/** Radians as degrees from -180 to 180. */
export function wrappedDeg(rad) {
  return isNumber(rad) ? Math.atan2(Math.sin(rad), Math.cos(rad)) * DEG : null;
}

export function clock(time_s) {
  return new Date(time_s * 1000).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit", hour12: false });
}

export function span(seconds) {
  if (!isNumber(seconds)) return DASH;
  const s = Math.max(0, seconds);
  if (s < 10) return `${s.toFixed(1)} s`;
  if (s < 120) return `${Math.round(s)} s`;
  if (s < 7200) return `${Math.floor(s / 60)} min ${Math.round(s % 60)} s`;
  return s < 172800 ? `${Math.floor(s / 3600)} h ${Math.round((s % 3600) / 60)} min` : `${Math.floor(s / 86400)} days`;
}

function digitsFor(value, significant, most) {
  const size = Math.abs(value);
  return size > 0 ? Math.min(most, Math.max(0, significant - 1 - Math.floor(Math.log10(size)))) : 0;
}

// What the health calls it: name, factor, unit.
const LEARNED = {
  gyro_bias_rad_s: ["Gyro bias", DEG * 3600, "°/h"],
  gyro_scale: ["Gyro scale", 1, ""],
  left_wheel_scale_error: ["Left wheel scale error", 100, "%"],
  right_wheel_scale_error: ["Right wheel scale error", 100, "%"],
  tread_m: ["Effective tread", 1, "m"],
  wheel_lag_s: ["Wheels behind gyro", 1000, "ms"],
  gyro_noise_rad_per_sqrt_s: ["Gyro noise", DEG * 60, "°/√h"],
  wheel_noise_m_per_sqrt_m: ["Wheel noise", 1000, "mm/√m"],
  turn_noise_rad_per_sqrt_rad: ["Turn noise", 1, "rad/√rad"],
  wheel_jitter_s: ["Wheel time jitter", 1000, "ms"],
};

/** [name, value, standard deviation] of a learned value; the digits are those that its sigma leaves. */
export function learned(name, entry) {
  const [label, factor, unit] = LEARNED[name] ?? [name, 1, ""];
  if (!isNumber(entry?.value)) return [label, DASH, ""];
  const value = entry.value * factor;
  const sigma = isNumber(entry.sigma) ? entry.sigma * factor : null;
  const digits = sigma ? digitsFor(sigma, 2, 6) : digitsFor(value, 3, 6);
  return [label, num(value, digits, sigma === null ? unit : ""), sigma === null ? "" : `± ${num(sigma, digits, unit)}`];
}
