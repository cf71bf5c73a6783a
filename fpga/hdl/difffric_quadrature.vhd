-- An incremental encoder's two signals to a count: one step an edge of either (x4), up where a leads.
library ieee;
use ieee.std_logic_1164.all;
use ieee.numeric_std.all;

entity difffric_quadrature is
  port (
    clk : in std_logic;
    reset : in std_logic;  -- of three cycles at least, in which the pins come to be known
    a : in std_logic;  -- pins, of no clock
    b : in std_logic;
    count : out signed(31 downto 0);
    illegal : out std_logic  -- both changed at once: the direction is lost, and the count stays
  );
end entity;

architecture rtl of difffric_quadrature is
  -- Each pin now (behind two flip-flops, the first of which may be metastable) and a cycle ago. Not
  -- reset, so that a pin that is high at a reset is no edge behind it.
  signal a_raw, a_now, a_before : std_logic := '0';
  signal b_raw, b_now, b_before : std_logic := '0';
  signal changed : std_logic_vector(1 downto 0);
  signal count_now : signed(31 downto 0) := (others => '0');

  attribute ASYNC_REG : string;
  attribute ASYNC_REG of a_raw : signal is "TRUE";
  attribute ASYNC_REG of a_now : signal is "TRUE";
  attribute ASYNC_REG of b_raw : signal is "TRUE";
  attribute ASYNC_REG of b_now : signal is "TRUE";
begin
  changed <= (a_now xor a_before) & (b_now xor b_before);
  illegal <= changed(1) and changed(0);
  count <= count_now;

  process (clk)
  begin
    if rising_edge(clk) then
      a_raw <= a;
      a_now <= a_raw;
      a_before <= a_now;
      b_raw <= b;
      b_now <= b_raw;
      b_before <= b_now;
      if reset = '1' then
        count_now <= (others => '0');
      elsif changed = "10" or changed = "01" then
        if (a_now xor b_before) = '1' then
          count_now <= count_now + 1;
        else
          count_now <= count_now - 1;
        end if;
      end if;
    end if;
  end process;
end architecture;
