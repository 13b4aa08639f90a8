import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { defineConfig, type Plugin } from "vite";

/**
 * All of the viewer as one page: its script and its styles stand in it, and its policy lets the
 * browser run those two alone and fetch nothing, whatever is written into the page later.
 */
const onePage: Plugin = {
  name: "one-page",
  apply: "build",
  enforce: "post",
  generateBundle(_, bundle) {
    const page = bundle["viewer.html"];
    if (page?.type !== "asset") throw new Error("vite made no viewer.html");
    let script = "";
    let style = "";
    for (const [name, file] of Object.entries(bundle)) {
      if (file === page) continue;
      if (file.type === "chunk") script += file.code;
      else if (name.endsWith(".css")) style += String(file.source);
      else throw new Error(`${name} does not fit into one page`);
      delete bundle[name];
    }
    script = script.replace(/<\/(?=script)/gi, "<\\/").trim();
    style = style.trim();
    if (/<!--/.test(script) || /<\/style/i.test(style)) throw new Error("a tag would end too early");
    const policy = [
      "default-src 'none'",
      `script-src ${hashed(script)}`,
      `style-src ${hashed(style)}`,
      "img-src data: blob:", // the photograph, and textures of models
      "connect-src data: blob:", // of a model's file, which three.js fetches from memory
      "base-uri 'none'",
      "form-action 'none'",
    ].join("; ");
    const licence = readFileSync("node_modules/three/LICENSE", "utf-8").trim();
    const html = String(page.source)
      .replace(/\s*<script type="module"[^>]*><\/script>/, "")
      .replace(/\s*<link rel="stylesheet"[^>]*>/, "")
      .replace(
        '<meta charset="utf-8" />',
        (charset) => `${charset}\n    <meta http-equiv="Content-Security-Policy" content="${policy}" />`,
      )
      .replace(/\s*<\/head>/, (end) => `\n    <style>${style}</style>${end}`)
      .replace(
        /\s*<\/body>/,
        (end) => `\n    <!-- The script holds three.js.\n${licence}\n    -->\n    <script type="module">${script}</script>${end}`,
      );
    page.source = html;
  },
};

const hashed = (text: string): string => `'sha256-${createHash("sha256").update(text).digest("base64")}'`;

// The page is committed as built, like the studio's.
export default defineConfig({
  build: {
    outDir: "../skylight/maps/data",
    emptyOutDir: true,
    target: "es2022",
    modulePreload: false,
    chunkSizeWarningLimit: 2000,
    rollupOptions: { input: "viewer.html" },
  },
  plugins: [onePage],
});
