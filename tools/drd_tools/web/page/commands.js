// The buttons, where the daemon takes commands; each is confirmed, and answered with the daemon's own words.

import { $ } from "./cards.js";
import { DEG } from "./format.js";

export function enableCommands(allowed) {
  $("commands").hidden = !allowed;
}

async function send(name, request) {
  $("outcome").textContent = "…";
  try {
    const answer = await fetch(`command/${name}`, {
      method: "POST",
      headers: { "Content-Type": "application/json", "X-Drd": "1" },
      body: request ? JSON.stringify(request) : "",
    });
    const text = await answer.text();
    const value = answer.headers.get("Content-Type")?.startsWith("application/json") ? JSON.parse(text) : { error: text.trim() };
    $("outcome").textContent = answer.ok ? done(name, value) : `refused: ${value.error}`;
  } catch (error) {
    $("outcome").textContent = `not sent: ${error.message}`;
  }
}

function done(name, answer) {
  if (name === "set_pose") return `The pose is set to ${answer.x_m} m, ${answer.y_m} m, ${(answer.heading_rad * DEG).toFixed(1)}°.`;
  if (name === "calibrate_bias") return `The gyro's bias is measured for ${answer.measuring_s} s. The robot must stand.`;
  return "The pose is back at the origin.";
}

/** Ask first. */
function confirmed(title, text, action) {
  $("confirm-title").textContent = $("confirm-yes").textContent = title;
  $("confirm-text").textContent = text;
  const dialog = $("confirm");
  dialog.returnValue = "no";
  dialog.onclose = () => dialog.returnValue === "yes" && action();
  dialog.showModal();
}

/** A number as people write it, with a comma or a true minus too; null where it is none. */
function number(form, name) {
  const text = form.elements[name].value.trim().replace(",", ".").replace("−", "-");
  const value = text === "" ? NaN : Number(text);
  form.elements[name].setCustomValidity(Number.isFinite(value) ? "" : "a number, please");
  return Number.isFinite(value) ? value : null;
}

$("set-pose").addEventListener("input", (event) => event.target.setCustomValidity(""));
$("set-pose").addEventListener("submit", (event) => {
  event.preventDefault();
  const form = event.target;
  const [x_m, y_m, heading, sigma_m, sigma] = ["x_m", "y_m", "heading_deg", "sigma_m", "sigma_deg"].map((name) => number(form, name));
  if (!form.reportValidity()) return;
  const request = { x_m, y_m, heading_rad: heading / DEG, sigma_m, sigma_rad: sigma / DEG };
  const where = `${x_m} m, ${y_m} m, ${heading}°, known to ${sigma_m} m and ${sigma}° (one sigma).`;
  confirmed("Set pose", where, () => send("set_pose", request));
});
$("reset").addEventListener("click", () => {
  confirmed("Reset", "Back to the origin; what was learned is forgotten, except the bias.", () => send("reset"));
});
$("calibrate").addEventListener("click", () => {
  confirmed("Measure gyro bias", "The robot must stand still meanwhile.", () => send("calibrate_bias"));
});
