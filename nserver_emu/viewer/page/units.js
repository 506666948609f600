// Conversions: inches and centimetres, tenths of the protocol, degrees, and their texts.

export const CM_PER_IN = 2.54;

export function unitIn(metric) { return metric ? 1 / CM_PER_IN : 1; }

export function unitName(metric) { return metric ? 'cm' : 'in'; }

export function lengthText(inches, metric, digits = 1) {
  const value = metric ? inches * CM_PER_IN : inches;
  return `${value.toFixed(digits)} ${metric ? 'cm' : 'in'}`;
}

export function degreesText(radians, digits = 1) {
  const degrees = radians * 180 / Math.PI;
  return `${(degrees - 360 * Math.floor(degrees / 360)).toFixed(digits)}°`;
}

export function tenthsOf(inches) { return Math.round(inches * 10); }

export function angleTenths(radians) {
  const tenths = Math.round(radians * 1800 / Math.PI);
  return ((tenths % 3600) + 3600) % 3600;
}
