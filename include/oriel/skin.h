/* Base colour on the surface: small square textures, of those faces of a brick that its surface looks at (formats/SCENE.md 4.4, 4.5). Integers alone: the same bits everywhere.
 *
 * Face 2 a looks along axis a, face 2 a + 1 against it; its texture spans the axes u = a + 1 and v = a + 2 (mod 3), texel u + ORL_SKIN_SIDE v at u / 2, v / 2 cells in the brick. Bricks that meet repeat the texels
 * of their border. */
#ifndef ORIEL_SKIN_H
#define ORIEL_SKIN_H
#include <stddef.h>
#include <stdint.h>

enum { ORL_SKIN_PER_CELL = 2, ORL_SKIN_SIDE = 8 * ORL_SKIN_PER_CELL + 1, ORL_SKIN_TEXELS = ORL_SKIN_SIDE * ORL_SKIN_SIDE, ORL_SKIN_FACES = 6, ORL_SKIN_MOST = 1 << 26 };     /* textures of a scene */

/* A brick's entry of the index: its first texture, and of which faces there are ones (bits), in rising order. */
unsigned orl_skin_mask(uint32_t entry);
uint32_t orl_skin_first(uint32_t entry);
/* Texture of a face that the mask has. */
uint32_t orl_skin_texture(uint32_t entry, int face);
/* Of the faces in mask (not 0), that which the SDF's gradient points at most; the first of equals. grad: magnitudes below 2^31. */
int orl_skin_face(unsigned mask, const int32_t grad[3]);
/* Linear base colour, Q16, at most 65535: bilinear in linear light. texture: [ORL_SKIN_TEXELS][3] of the scene's bytes; at: place in the brick, Q12 cells, taken into it. */
void orl_skin_colour(const uint8_t *texture, int face, const int32_t at[3], uint32_t rgb[3]);
#endif
