import { constants, gzipSync } from "node:zlib";
import { defineConfig, type Plugin } from "vite";

/**
 * WebAssembly is shipped compressed, 4 MB instead of 14; the server sends it as such. The same
 * bytes on every machine: zlib's header carries no time.
 */
const compressedWebAssembly: Plugin = {
  name: "compressed-webassembly",
  apply: "build",
  enforce: "post",
  generateBundle(_, bundle) {
    for (const [name, file] of Object.entries(bundle)) {
      if (!name.endsWith(".wasm") || file.type !== "asset") continue;
      const source = gzipSync(file.source, { level: constants.Z_BEST_COMPRESSION });
      this.emitFile({ type: "asset", fileName: `${name}.gz`, source });
      delete bundle[name];
    }
  },
};

const output = {
  entryFileNames: "assets/[name].js",
  chunkFileNames: "assets/[name].js",
  assetFileNames: "assets/[name][extname]",
};

// Names without hashes: the built files are committed, and a change should show as one. The server
// tells browsers to ask again, so that an old file never meets a new one.
export default defineConfig({
  base: "./",
  build: {
    outDir: "../skylight/studio/static",
    emptyOutDir: true,
    target: "es2022",
    chunkSizeWarningLimit: 2000,
    rollupOptions: { output },
  },
  worker: { format: "es", rollupOptions: { output } },
  plugins: [compressedWebAssembly],
  server: { proxy: { "/api": "http://127.0.0.1:8600" } },
});
