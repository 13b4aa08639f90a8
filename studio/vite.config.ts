import { defineConfig } from "vite";

// Names without hashes: the built files are committed, and a change should show as one. The server
// tells browsers to ask again, so that an old file never meets a new one.
export default defineConfig({
  base: "./",
  build: {
    outDir: "../skylight/studio/static",
    emptyOutDir: true,
    target: "es2022",
    chunkSizeWarningLimit: 2000,
    rollupOptions: {
      output: {
        entryFileNames: "assets/[name].js",
        chunkFileNames: "assets/[name].js",
        assetFileNames: "assets/[name][extname]",
      },
    },
  },
  server: { proxy: { "/api": "http://127.0.0.1:8600" } },
});
