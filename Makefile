# Oriel
#   make              build/host/oriel, build/host/oriel-train
#   make demo         procedural attraction -> fit -> widened photo beside the truth (build/demo)
#   make test         everything that CI runs; `make test SAN=1` under ASan and UBSan
#   make bench        run time against error, kernels against memcpy
#   make curves       PSNR against CPU minutes beside the NeRF-W baseline (hours; goes on where it was stopped); SCENES="FOLDER..."
#   make ablation     what each part of the light model is worth (an hour; goes on where it was stopped); SCENE=FOLDER, CHECKPOINT=FILE of a finished fit
#   make deps         Debian packages by name (nothing when all are there)
#   make BOARD=rpi4   the runtime for a board (boards/*.mk); also rpi5, armhf
#   make clean        options: CC=clang  SAN=1  TRAIN_ARCH=-march=native  MPI= (without MPI, though mpicc is there)
BOARD ?= host
TRAIN_ARCH ?= -march=native
# a comma for use in function arguments
, := ,
B := build/$(BOARD)$(if $(SAN),-san)
all:
ifneq ($(BOARD),host)
include boards/$(BOARD).mk
else
ARCH := $(shell uname -m)
endif
ifeq ($(origin CXX),default)
CXX := $(if $(findstring clang,$(CC)),clang++,g++)
endif
PKG ?= pkg-config
have = $(shell $(PKG) --exists $(1) 2>/dev/null && echo 1)
OPT_JPEG := $(call have,libjpeg)
OPT_PNG := $(call have,libpng)
OPT_EXR := $(call have,OpenEXR)
# for oriel bench --mlp alone
OPT_XNN := $(if $(filter host,$(BOARD)),$(shell printf '\043include <xnnpack.h>' | $(CC) -E - >/dev/null 2>&1 && echo 1))
LIBS := $(if $(OPT_JPEG),$(shell $(PKG) --libs libjpeg)) $(if $(OPT_PNG),$(shell $(PKG) --libs --static libpng)) $(if $(OPT_EXR),-lOpenEXRCore) -lpthread -lm
DEFS := $(if $(OPT_JPEG),-DORL_HAVE_JPEG) $(if $(OPT_PNG),-DORL_HAVE_PNG) $(if $(OPT_EXR),-DORL_HAVE_EXR $(shell $(PKG) --cflags OpenEXR))
FLAGS := -g -O3 -Wall -Wextra -D_GNU_SOURCE -Iinclude -I. -MMD -MP $(CPU) $(DEFS) $(if $(SAN),-fsanitize=address$(,)undefined -fno-omit-frame-pointer -fno-sanitize-recover=undefined)
LINK := $(if $(SAN),-fsanitize=address$(,)undefined) $(LDFLAGS)

KERNELS := $(wildcard runtime/kernels/*.c)
NOT := $(if $(filter x86_64,$(ARCH)),,%_avx2.c %_avx512.c) $(if $(filter aarch64,$(ARCH)),,%_neon.c %_dotprod.c)
LIB := $(wildcard formats/*.c) $(filter-out runtime/main.c runtime/cmd_%.c,$(wildcard runtime/*.c)) $(filter-out $(NOT),$(KERNELS))
APP := $(wildcard runtime/main.c runtime/cmd_*.c)
MPI ?= $(if $(SAN)$(filter-out host,$(BOARD)),,$(shell command -v mpicc))
MPI_SHOW := $(if $(MPI),$(shell mpicc -show))
MPI_LIBS := $(if $(MPI),-Wl$(,)--as-needed $(filter -L% -l%,$(MPI_SHOW)))
TRAIN := $(filter-out trainer/main.c $(if $(MPI),trainer/ranks.c,trainer/ranks_mpi.c),$(wildcard trainer/*.c)) $(wildcard trainer/*.cpp)
TESTS := $(patsubst tests/%.c,$B/tests/%,$(wildcard tests/test_*.c))
TOOLS := $(patsubst tests/tools/%.c,$B/tools/%,$(wildcard tests/tools/*.c))
obj = $(patsubst %,$B/obj/%.o,$(basename $(1)))

all: $(if $(APP),$B/oriel) $(if $(filter host,$(BOARD)),$B/oriel-train)
$B/liboriel.a: $(call obj,$(LIB))
$B/libtrainer.a: $(call obj,$(TRAIN))
$B/%.a:
	@rm -f $@
	ar rcs $@ $^
$B/oriel: $(call obj,$(APP)) $B/liboriel.a
	$(CC) $(LINK) -o $@ $^ $(if $(OPT_XNN),-lXNNPACK) $(LIBS)
$B/oriel-train: $B/obj/trainer/main.o $B/libtrainer.a $B/liboriel.a
	$(CXX) $(LINK) -o $@ $^ -lOpenImageIO -lOpenImageIO_Util $(LIBS) $(MPI_LIBS)
$B/tests/%: $B/obj/tests/%.o $B/libtrainer.a $B/liboriel.a
	@mkdir -p $(@D)
	$(CXX) $(LINK) -o $@ $^ -lcmocka -lOpenImageIO -lOpenImageIO_Util $(LIBS) $(MPI_LIBS)
$B/tools/%: $B/obj/tests/tools/%.o $(if $(filter host,$(BOARD)),$B/libtrainer.a) $B/liboriel.a
	@mkdir -p $(@D)
	$(if $(filter host,$(BOARD)),$(CXX) $(LINK) -Wl$(,)--as-needed -o $@ $^ -lOpenImageIO -lOpenImageIO_Util $(MPI_LIBS),$(CC) $(LINK) -o $@ $^) $(LIBS)
# what was compiled before a library arrived is compiled again
$(shell mkdir -p $B && echo '$(CC) $(FLAGS) $(TRAIN_ARCH) $(MPI) $(OPT_XNN)' | cmp -s - $B/flags || echo '$(CC) $(FLAGS) $(TRAIN_ARCH) $(MPI) $(OPT_XNN)' > $B/flags)
$B/obj/%.o: %.c $B/flags
	@mkdir -p $(@D)
	$(CC) -std=c11 $(FLAGS) $(ISA) -c -o $@ $<
$B/obj/%.o: %.cpp $B/flags
	@mkdir -p $(@D)
	$(CXX) -std=c++17 $(FLAGS) $(ISA) -c -o $@ $<
$B/obj/formats/%.o $B/obj/runtime/%.o: ISA = -ffp-contract=off
$B/obj/runtime/cmd_bench_mlp.o: ISA = $(if $(OPT_XNN),-DORL_HAVE_XNN)
$B/obj/trainer/%.o: ISA = $(TRAIN_ARCH)
$B/obj/trainer/ranks_mpi.o: ISA = $(filter -I%,$(MPI_SHOW))
$B/obj/trainer/mlp.o $B/obj/trainer/encoding.o $B/obj/trainer/nerfw.o: ISA = $(TRAIN_ARCH) -ffp-contract=fast -fno-math-errno
$(call obj,$(filter %_avx2.c,$(KERNELS))): ISA = -ffp-contract=off -mavx2
$(call obj,$(filter %_avx512.c,$(KERNELS))): ISA = -ffp-contract=off -mavx2 -mavx512f -mavx512bw -mavx512cd -mavx512dq -mavx512vl -mavx512vbmi -mavx512vnni
$(call obj,$(filter %_dotprod.c,$(KERNELS))): ISA = -ffp-contract=off -mcpu=cortex-a76

tests: all $(TESTS) $(TOOLS)
deps:
	@tests/deps.sh
test: deps
	@$(MAKE) --no-print-directory tests
	@tests/run.sh $B
demo: deps
	@$(MAKE) --no-print-directory all $B/tools/attraction $B/tools/panel
	@tests/demo.sh $B
bench: tests
	@tests/bench.sh $B
SCENES ?= ../shared/data/basilica ../shared/data/reichstag
curves: all
	@tests/curves.sh $B $(SCENES)
ablation: all
	@tests/ablation.sh $B "$(SCENE)" $(CHECKPOINT)
clean:
	rm -rf build
.PHONY: all tests deps test demo bench curves ablation clean
.SECONDARY:
-include $(shell find $B/obj -name '*.d' 2>/dev/null)
