// Validates glTF files and prints the reports as one JSON list: node validate.mjs FILE...
import { readFileSync } from "node:fs";
import validator from "gltf-validator";

const reports = [];
for (const file of process.argv.slice(2)) {
  const { issues } = await validator.validateBytes(new Uint8Array(readFileSync(file)), { uri: file, maxIssues: 50 });
  reports.push({ file, errors: issues.numErrors, warnings: issues.numWarnings, messages: issues.messages });
}
console.log(JSON.stringify(reports));
